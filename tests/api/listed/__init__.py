"""Answers of lists, byte by byte, from a database whose rows are always the same."""
