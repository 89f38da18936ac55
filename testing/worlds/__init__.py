"""Recordings, label sets, benchmarks and submissions that are laid into a platform."""
