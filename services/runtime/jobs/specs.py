"""Job specs, the attempt that a handler is given, and the outcome it returns.

**Conventions.** `kind` is `<queue>.<stage>`. Arguments and results are small JSON objects; data goes through the store.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:  # a graph of jobs is also run where there is no database
    from sqlalchemy.orm import Session

TERMINAL = ("succeeded", "failed", "cancelled")
RETICENT = ("eval",)
BULK = ("ingest", "labeler")
"""Queues whose jobs write files without a limit of their own; these jobs stop at the disk's reserve."""


def queue_of(kind: str) -> str:
    """The queue in which jobs of this kind wait."""
    return kind.partition(".")[0]


@dataclass(frozen=True)
class JobSpec:
    """A job to be. `key` names it among its batch; `needs` are keys of that batch that must succeed before it, `after`
    kinds of jobs that its run has already, which must succeed too."""

    kind: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    key: str = ""
    needs: tuple[str, ...] = ()
    after: tuple[str, ...] = ()

    @property
    def queue(self) -> str:
        return queue_of(self.kind)


@dataclass(frozen=True)
class Context:
    """For whom a job works and how urgently (higher first)."""

    owner_id: str
    sequence_id: str | None = None
    priority: int = 0


def nothing(_session: "Session") -> None:
    """Write no rows."""


@dataclass(frozen=True)
class Outcome:
    """The result of a handler that succeeds.

    `then` are jobs of the same run that come to life with this success; `commit` writes rows in the same transaction as
    the success itself, so both happen or neither. An attempt that lost the race
    never commits.
    """

    result: Mapping[str, Any] = field(default_factory=dict)
    then: tuple[JobSpec, ...] = ()
    commit: Callable[["Session"], None] = nothing


class Attempt(Protocol):
    """One attempt as its handler sees it: its ids, its arguments, and ways to report while it works."""

    @property
    def job_id(self) -> str: ...

    @property
    def root_id(self) -> str: ...

    @property
    def sequence_id(self) -> str | None: ...

    @property
    def arguments(self) -> Mapping[str, Any]: ...

    def progress(self, stage: str, done: int, total: int) -> None:
        """Say how far it is, as often as it likes. Raises `JobCancelledError` when the job is to stop."""
        ...

    def log(self, event: str, level: str = "info", **facts: Any) -> None:
        """Keep a line with the attempt, readable while it runs."""
        ...


Handler = Callable[[Attempt], Outcome]
Handlers = Mapping[str, Handler]
