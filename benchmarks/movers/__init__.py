"""Movers: what walkers and vehicles leave behind in the labels, at LiDAR rates of 1 to 20 Hz."""
