"""The surface: point map, moving objects, Poisson reconstruction, terrain features."""
