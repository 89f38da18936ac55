"""Benchmarks: phases, teams, submissions, scores, leaderboards, and who may see what.

**Conventions.** No kernel is loaded here: what counts voxels is `services/eval`, reached by jobs only.
"""
