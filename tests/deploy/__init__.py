"""Tests of what puts the platform on a machine."""
