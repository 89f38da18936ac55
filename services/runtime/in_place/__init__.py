"""Recordings and datasets that are read in place, below roots that the settings allow."""
