"""Catalogue of codes: the meaning of each finding and failed run, its effect on labels, and the remedy."""
