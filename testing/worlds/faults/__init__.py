"""Faults of recordings, as data: each alters a sound drive in one way."""
