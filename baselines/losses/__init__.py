"""Losses of voxels, images' depths and masks, each as in its paper."""
