"""Replays a recording: reads ahead, and sends each sample when it is due."""
