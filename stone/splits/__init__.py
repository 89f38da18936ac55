"""Splits: the composition of a dataset, its division, and the rules for it."""
