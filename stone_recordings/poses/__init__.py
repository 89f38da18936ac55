"""Poses: where the robot was, from an INS, odometry, TF or the sweeps alone."""
