"""In which step of a request processor time goes: samples of the stack, a step each.

**Conventions.** The interval timer counts processor time of the whole process, so the requests must be worked on by the
thread that is sampled (`in_process.py`). A sample belongs to the first step that knows one of its frames, from the
innermost outwards; what authenticates and what logs are steps whatever they call.
"""

import signal
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

EVERY_S = 0.001
WHOLE = {"identify": ("/api/deps.py", "authentication"), "_note": ("/middleware/entry.py", "log line, counts")}
"""Functions, the file they are in, and the step that they are with all that they call."""
STEPS = (
    ("/structlog/", "log line, counts"),
    ("/logging/", "log line, counts"),
    ("/sqlalchemy/engine/default.py", "database"),
    ("/sqlalchemy/engine/cursor.py", "database"),
    ("/psycopg/", "database"),
    ("/sqlalchemy/orm/", "ORM"),
    ("/sqlalchemy/", "statements"),
    ("/pydantic/", "Pydantic"),
    ("/fastapi/_compat/", "serialising"),
    ("/json/", "serialising"),
    ("/fastapi/", "routing"),
    ("/starlette/", "routing"),
    ("/api/middleware/", "middleware"),
    ("/api/", "views"),
    ("/services/", "views"),
)
REST = "rest"
NAMES = tuple(dict.fromkeys([*(step for _, step in WHOLE.values()), *(step for _, step in STEPS), REST]))


def step_of(frame: FrameType | None) -> str:
    """The step that this stack is in."""
    found, outer = "", frame
    while outer is not None:
        path, name = outer.f_code.co_filename, outer.f_code.co_name
        if name in WHOLE and path.endswith(WHOLE[name][0]):
            return WHOLE[name][1]
        found = found or next((step for part, step in STEPS if part in path), "")
        outer = outer.f_back
    return found or REST


class StepSamples:
    """Samples by the kind of request that is being worked on."""

    def __init__(self) -> None:
        self.kind = ""
        self.counts: dict[str, Counter[str]] = {}

    def shares(self, kind: str) -> dict[str, float]:
        """The share of each step."""
        counts = self.counts.get(kind, Counter())
        return {name: counts[name] / max(1, counts.total()) for name in NAMES}

    @contextmanager
    def taken(self) -> Iterator[None]:
        """Samples are taken until the end of the block."""
        before = signal.signal(signal.SIGPROF, self._take)
        signal.setitimer(signal.ITIMER_PROF, EVERY_S, EVERY_S)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            signal.signal(signal.SIGPROF, before)

    def _take(self, _number: int, frame: FrameType | None) -> None:
        if self.kind:
            self.counts.setdefault(self.kind, Counter())[step_of(frame)] += 1
