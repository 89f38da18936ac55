"""The rules of a benchmark: who may send in what, by which pair it is scored, and what is shown of it to whom.

**Conventions.** No kernel is loaded here: what counts voxels is `services/eval`, reached by jobs only.
"""
