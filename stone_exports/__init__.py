"""Reads exports in the nuScenes layout, as folders or in place from the server's tars, for models and the geometric
baseline.
"""
