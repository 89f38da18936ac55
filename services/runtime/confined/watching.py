"""How an attempt at a job watches what it confines."""

from services.runtime.confined.running import Watch
from services.runtime.jobs.specs import Attempt


def watching(attempt: Attempt, stage: str, total: int) -> Watch:
    """What the child says is passed on; while it says nothing, what it said last: so the wish to stop is heard."""
    last = [(stage, 0, total)]

    def told(stage: str, done: int, total: int) -> None:
        last[0] = (stage, done, total)
        attempt.progress(*last[0])

    return Watch(glance=lambda: attempt.progress(*last[0]), progress=told)
