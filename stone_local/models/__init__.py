"""Shared parts of the model commands."""
