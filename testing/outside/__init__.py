"""Analytic worlds with their truth, which share no code with `simulator/` or the labeler."""
