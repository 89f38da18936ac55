"""Mutation testing: small random faults put into a copy of the tree, and whether its tests notice them."""
