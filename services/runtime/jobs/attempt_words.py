"""What a running attempt has to say: how far it is, and its log lines."""

from dataclasses import dataclass
from typing import Any

from services.runtime.orm.base import now_ns

LONGEST_STAGE = 64
INTEGERS = range(-(2**31), 2**31)
AttemptKey = tuple[str, int]


@dataclass(frozen=True)
class JobProgress:
    """`done` of `total` in a stage, as it was said at `told_ns`."""

    stage: str
    done: int
    total: int
    told_ns: int

    @property
    def fits(self) -> bool:
        """Whether the columns take it: a sandboxed child says what it likes."""
        return _is_text(self.stage, LONGEST_STAGE) and self.done in INTEGERS and self.total in INTEGERS

    def columns(self) -> dict[str, Any]:
        """Of the job's row."""
        return {"stage": self.stage, "done": self.done, "total": self.total, "progress_ns": self.told_ns}


@dataclass(frozen=True)
class AttemptLine:
    """One log line; `number` counts from 0 within its attempt."""

    number: int
    level: str
    event: str
    facts: dict[str, Any]
    logged_ns: int


@dataclass(frozen=True)
class AttemptWords:
    """What attempt `attempt` of a job says in one turn; that it says anything means that it lives."""

    job_id: str
    attempt: int
    progress: JobProgress | None = None
    lines: tuple[AttemptLine, ...] = ()

    @property
    def key(self) -> AttemptKey:
        return self.job_id, self.attempt

    def columns(self) -> dict[str, Any]:
        """What its progress changes in the job's row; nothing where there is none, or none that fits."""
        return self.progress.columns() if self.progress and self.progress.fits else {}


def progress_now(stage: str, done: int, total: int) -> JobProgress:
    return JobProgress(stage, done, total, now_ns())


def _is_text(said: str, longest: int) -> bool:
    return len(said) <= longest and "\x00" not in said and not any("\ud800" <= one <= "\udfff" for one in said)
