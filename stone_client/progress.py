"""Progress of the pipelines: bars on a terminal, a line per stage elsewhere; always on stderr.

**Conventions.** A pipeline reports `(stage, done, total)`; stages may return (a demo labels once and scores once).
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    DownloadColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)

Report = Callable[[str, int, int], None]


@contextmanager
def reported() -> Iterator[Report]:
    """Yield the function that the pipelines call with their progress."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _Lines(console)
        return
    columns = (TextColumn("{task.description:<12}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as bars:
        yield _Bars(bars)


@contextmanager
def transferred() -> Iterator[Report]:
    """The same for bytes: how many, how fast, how long yet."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _Lines(console)
        return
    bytes_columns = (DownloadColumn(), TransferSpeedColumn(), TimeRemainingColumn())
    with Progress(TextColumn("{task.description:<12}"), BarColumn(), *bytes_columns, console=console) as bars:
        yield _Bars(bars)


class _Bars:
    def __init__(self, bars: Progress) -> None:
        self._bars = bars
        self._task_of: dict[str, TaskID] = {}

    def __call__(self, stage: str, done: int, total: int) -> None:
        if stage not in self._task_of:
            self._task_of[stage] = self._bars.add_task(stage, total=total)
        self._bars.update(self._task_of[stage], completed=done, total=total)


class _Lines:
    """Logs and pipes get one line when a stage is done, not a thousand while it runs."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def __call__(self, stage: str, done: int, total: int) -> None:
        if done == total:
            self._console.print(f"{stage} {done}/{total}", highlight=False, markup=False)
