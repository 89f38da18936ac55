"""Layers of TPVFormer: three planes through a volume, what cameras see of their cells, and attention between them."""
