"""Recordings and datasets that stay where they lie, below roots that the settings allow."""
