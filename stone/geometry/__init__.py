"""Geometry: transforms, poses between poses, the voxel lattice."""
