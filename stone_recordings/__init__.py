"""Recordings: ROS bags, their messages, calibrations and clocks, read and synchronised into a sequence."""
