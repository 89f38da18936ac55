"""Several bags as one recording: each moved onto the clock of the one with the LiDAR."""
