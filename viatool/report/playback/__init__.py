"""Runs as they are played: ROS messages in the order of their stamps, as plain data that one format writes."""
