"""Comparison of two label sets of one run of the robot, of which neither is the truth."""
