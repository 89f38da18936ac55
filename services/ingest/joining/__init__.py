"""Several recordings of one run joined into one, the offsets of their clocks measured."""
