"""Measurements of the models of Table II; they need torch: `make bench-models`."""
