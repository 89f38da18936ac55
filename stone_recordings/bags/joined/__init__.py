"""Several bags as one recording: each moved onto the clock of the bag with the LiDAR."""
