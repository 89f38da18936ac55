"""Sensors: calibration, clocks, deskewing, and the data of a synchronised sequence."""
