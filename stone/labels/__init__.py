"""Labels: from driven voxels and terrain features to the label grid of a frame."""
