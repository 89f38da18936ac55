"""Poses of the robot: from an INS, odometry, TF or the sweeps alone."""
