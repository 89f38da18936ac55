"""Splits: what a dataset is made of, how it is divided, and the rules for that."""
