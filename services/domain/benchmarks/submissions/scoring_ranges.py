"""How a scoring is divided: ranges of frames that are counted by themselves, then one join of them all.

**Conventions.** [start, stop) count frames in the order of the ground truth's manifest. `stone score` counts the
ranges one after another, the queue each in a job of its own
(`services/domain/benchmarks/submissions/scoring_jobs.py`).
"""

PART_FRAMES = 500
Span = tuple[int, int]


def ranges_of(frames: int) -> tuple[Span, ...]:
    """Return the ranges in their order; without frames, one empty range."""
    return tuple((start, min(start + PART_FRAMES, frames)) for start in range(0, max(frames, 1), PART_FRAMES))
