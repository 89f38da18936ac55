"""Analytic worlds with their truth, which share no code with `simulator/` and with what makes labels."""
