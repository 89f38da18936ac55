"""The science of the STONE dataset as pure functions: numpy in, numpy out.

Source: Park et al., "STONE Dataset: A Scalable Multi-Modal Surround-View 3D Traversability Dataset for
Off-Road Robot Navigation", ICRA 2026. Equation numbers in docstrings refer to that paper.
"""
