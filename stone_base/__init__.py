"""Shared basics: errors, findings, names and the label grid. Only the standard library is used."""
