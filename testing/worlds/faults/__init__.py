"""Faults of recordings, as data: what may be wrong, made of a sound drive that is altered in one way each."""
