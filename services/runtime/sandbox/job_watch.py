"""Progress and cancellation of a job attempt while its sandboxed child works."""

from services.runtime.jobs.specs import Attempt
from services.runtime.sandbox.parent import SandboxWatch


def sandbox_watch_of(attempt: Attempt, stage: str, total: int) -> SandboxWatch:
    """What the child says is passed on; while it says nothing, what it said last: so the wish to stop is heard."""
    last = [(stage, 0, total)]

    def told(stage: str, done: int, total: int) -> None:
        last[0] = (stage, done, total)
        attempt.progress(*last[0])

    return SandboxWatch(on_poll=lambda: attempt.progress(*last[0]), progress=told)
