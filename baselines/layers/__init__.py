"""Layers that several rows are made of; each file names the paper and the official code that it agrees with."""
