"""Bags: readers of MCAP, rosbag2 and ROS 1 files, whole, split, compressed or damaged."""
