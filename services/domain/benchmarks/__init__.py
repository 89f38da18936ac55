"""Benchmarks: phases, teams, submissions, scores, leaderboards, and access to them.

**Conventions.** This package loads no kernel: jobs of `services/eval` count the voxels.
"""
