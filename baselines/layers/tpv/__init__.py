"""Layers of TPVFormer: three planes through a volume, camera features of their cells, and attention between them."""
