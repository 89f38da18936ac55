"""Reads published datasets completely and strictly: nuScenes tables with samples and labels, and Occ3D's layout."""
