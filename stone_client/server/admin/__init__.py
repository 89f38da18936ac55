"""Requests of administrators: users, benchmarks from a file, re-scores."""
