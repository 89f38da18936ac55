"""The rows of Table II as modules; `occupancy_model.py` is what they have in common."""
