"""Recordings, label sets, benchmarks and submissions, created directly in a platform."""
