"""Several recordings of one run joined: which messages they share, whose clock is whose, what is measured of it."""
