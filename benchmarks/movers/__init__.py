"""Movers: remains of walkers and vehicles in the labels, at LiDAR rates of 1 to 20 Hz."""
