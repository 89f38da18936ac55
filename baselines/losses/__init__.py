"""Losses of voxels, images' depths and masks, each as its paper has it."""
