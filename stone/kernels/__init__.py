"""Kernels: single steps on machine words, to be called from compiled loops."""
