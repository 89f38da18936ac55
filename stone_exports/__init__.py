"""Reads exports of the nuScenes layout, as folders or in place in the tars that a server gives: what models and the
geometric baseline predict from."""
