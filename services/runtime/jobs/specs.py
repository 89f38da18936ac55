"""Job specs, the attempt that a handler receives, and the outcome it returns.

**Conventions.** `kind` is `<queue>.<stage>`. Arguments and results are small JSON objects; data goes through the store.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:  # a graph of jobs can run without a database
    from sqlalchemy.orm import Session

TERMINAL = ("succeeded", "failed", "cancelled")
RETICENT = ("eval",)
BULK = ("ingest", "labeler")
"""Queues whose jobs write files without their own limit; these jobs stop at the disk's reserve."""


def queue_of(kind: str) -> str:
    """Return the queue in which jobs of this kind wait."""
    return kind.partition(".")[0]


@dataclass(frozen=True)
class JobSpec:
    """A job to create.

    - `key`: its name within its batch
    - `needs`: keys of the batch's jobs that must succeed first
    - `after`: kinds of existing jobs of its run that must succeed first
    """

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
    """The owner of a job and its urgency (higher first)."""

    owner_id: str
    sequence_id: str | None = None
    priority: int = 0


def nothing(_session: "Session") -> None:
    """Write no rows."""


@dataclass(frozen=True)
class Outcome:
    """The result of a handler that succeeds.

    `then` are jobs of the same run that are created with this success; `commit` writes rows in the transaction of the
    success, so both happen or neither. An attempt that has lost its lease never commits.
    """

    result: Mapping[str, Any] = field(default_factory=dict)
    then: tuple[JobSpec, ...] = ()
    commit: Callable[["Session"], None] = nothing


class Attempt(Protocol):
    """One attempt as its handler sees it: its ids, its arguments, and methods to report."""

    @property
    def job_id(self) -> str: ...

    @property
    def root_id(self) -> str: ...

    @property
    def sequence_id(self) -> str | None: ...

    @property
    def arguments(self) -> Mapping[str, Any]: ...

    def progress(self, stage: str, done: int, total: int) -> None:
        """Report progress, as often as necessary. Raises `JobCancelledError` if the job must stop."""
        ...

    def log(self, event: str, level: str = "info", **facts: Any) -> None:
        """Store a log line of the attempt, readable while it runs."""
        ...


Handler = Callable[[Attempt], Outcome]
Handlers = Mapping[str, Handler]
