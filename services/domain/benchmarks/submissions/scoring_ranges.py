"""Division of a scoring into ranges of frames that are counted separately and then joined.

**Conventions.** [start, stop) count frames in the order of the ground truth's manifest. `stone score` counts the ranges
one after another; the queue counts each range in its own job
(`services/domain/benchmarks/submissions/scoring_jobs.py`).
"""

PART_FRAMES = 500
Span = tuple[int, int]


def ranges_of(frames: int) -> tuple[Span, ...]:
    """Return the ranges in their order; without frames, one empty range."""
    return tuple((start, min(start + PART_FRAMES, frames)) for start in range(0, max(frames, 1), PART_FRAMES))
