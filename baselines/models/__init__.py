"""The rows of Table II as modules; `occupancy_model.py` is their common base."""
