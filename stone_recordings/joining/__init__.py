"""Joining of several recordings of one run: shared messages, shared clocks, and measured offsets."""
