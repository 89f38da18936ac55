"""Comparison of two label sets of one run of the robot, without a ground truth."""
