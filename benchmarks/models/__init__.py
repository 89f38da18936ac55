"""Measurements of the models of Table II; they require torch: `make bench-models`."""
