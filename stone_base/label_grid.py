"""Extent and shape of the label grid around the robot (`stone/labels/grid.py` says how it lies)."""

GRID_MIN_M = (-25.6, -25.6, -2.0)
GRID_MAX_M = (25.6, 25.6, 4.4)
GRID_SHAPE = (256, 256, 32)
VOXELS = GRID_SHAPE[0] * GRID_SHAPE[1] * GRID_SHAPE[2]
