"""Sensors: calibration, clocks, deskewing, and the values that a synchronised sequence is made of."""
