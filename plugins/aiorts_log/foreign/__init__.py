"""Imports recordings of other systems, ROS 2 bags and JSON messages, and exports to ROS 2."""
