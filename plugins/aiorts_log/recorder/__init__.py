"""Writes a recording in a thread of its own: queue, chunks, rotation, durability."""
