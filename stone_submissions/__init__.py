"""Submissions: a zip with one prediction per frame, read without trust, and the verdict on it."""
