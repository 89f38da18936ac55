"""Synchronisation: frames at the LiDAR's stamps, with the samples of the other sensors."""
