"""Submissions: a zip of one prediction per frame, read without trust, and the verdict on it."""
