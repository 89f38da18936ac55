"""Bags: messages out of MCAP and rosbag2 files, whole, split, compressed or damaged."""
