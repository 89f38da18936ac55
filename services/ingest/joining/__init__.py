"""Several recordings of one run joined into one, with measured clock offsets."""
