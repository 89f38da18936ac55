"""Progress of the pipelines: bars on a terminal, a line every 10 s or 10 % elsewhere; always on stderr.

**Conventions.** A pipeline reports `(stage, done, total)`; a stage may start again. The stages of a server's jobs have
the titles of its pages (`CountedStage`); other stages have the titles of `TITLES`. `--no-progress` and `--quiet` (or
their environment variables) turn progress off.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from stone_client.streams import is_progress_shown

Report = Callable[[str, int, int], None]
Clock = Callable[[], datetime]

EVERY_S, EVERY_RATIO = 10.0, 0.1
LEAST_PAUSE_S = 1.0  # between the lines of a stage that takes only a few seconds
TITLES: Mapping[str, tuple[str, str]] = {
    "hash": ("Compute the checksum", "bytes"),
    "upload": ("Upload", "bytes"),
    "files": ("Download files", "files"),
    "frames": ("Frames", "frames"),
    "score": ("Score frames", "frames"),
    "predict": ("Predict frames", "frames"),
    "compare": ("Compare frames", "frames"),
    "export": ("Export the labels", "frames"),
    "odometry": ("Estimate odometry", "sweeps"),
    "build world": ("Build the world", "steps"),
    "record sweeps": ("Record sweeps", "sweeps"),
    "refine poses": ("Refine poses", "steps"),
}
"""Title and unit of the stages of commands; any other stage is its own title, and counts parts."""
BYTE_UNITS = ((10**12, "TB"), (10**9, "GB"), (10**6, "MB"), (10**3, "kB"), (1, "bytes"))


class CountedStage(str):
    """The title of a stage of a server's job: it counts `unit`, even in a command that transfers bytes."""

    unit: str

    def __new__(cls, title: str, unit: str) -> "CountedStage":
        stage = super().__new__(cls, title)
        stage.unit = unit
        return stage


@contextmanager
def reported() -> Iterator[Report]:
    """Yield the function that the pipelines call with their progress, in counts."""
    yield from _shown(is_bytes=False)


@contextmanager
def transferred() -> Iterator[Report]:
    """Yield the function that transfers call with their progress, in bytes."""
    yield from _shown(is_bytes=True)


def _shown(*, is_bytes: bool) -> Iterator[Report]:
    console = Console(stderr=True, highlight=False, markup=False)
    if not is_progress_shown():
        yield lambda _stage, _done, _total: None
    elif not console.is_terminal:
        yield ProgressLines(console.print, is_bytes=is_bytes)
    else:
        columns = (
            TextColumn("{task.description:<28}", markup=False),
            BarColumn(),
            TextColumn("{task.fields[figures]}"),
        )
        with Progress(*columns, TimeElapsedColumn(), console=console) as bars:
            yield _Bars(bars, is_bytes=is_bytes)


@dataclass
class StagePace:
    """A stage since its first report: its progress, rate and remaining time."""

    began: datetime
    first: int
    unit: str
    done: int
    total: int
    printed_at: datetime
    printed: int

    def figures(self, now: datetime) -> str:
        """Return for example `12.4 of 50.0 GB, 95 MB/s, 6 min left`."""
        is_bytes = self.unit == "bytes"
        amount = bytes_of(self.done, self.total) if is_bytes else f"{self.done:,} of {self.total:,} {self.unit}"
        spent_s = (now - self.began).total_seconds()
        rate = (self.done - self.first) / spent_s if spent_s > 0 else 0.0
        if self.done >= self.total:
            return f"{amount}, done in {duration(spent_s)}" if spent_s >= LEAST_PAUSE_S else amount
        if rate <= 0:
            return amount
        speed = f"{bytes_of(round(rate))}/s" if is_bytes else f"{rate:,.3g}/s"
        return f"{amount}, {speed}, {duration((self.total - self.done) / rate)} left"

    def is_due(self, now: datetime) -> bool:
        """Return whether this report gets a line in a log."""
        since_s = (now - self.printed_at).total_seconds()
        is_far = self.done - self.printed >= EVERY_RATIO * self.total and since_s >= LEAST_PAUSE_S
        return self.done >= self.total or is_far or since_s >= EVERY_S


class StagePaces:
    """The pace of each stage; a restarted stage has a new pace."""

    def __init__(self, *, is_bytes: bool, now: Clock = datetime.now) -> None:
        self._is_bytes, self.now = is_bytes, now
        self._pace_of: dict[str, StagePace] = {}

    def after(self, stage: str, done: int, total: int) -> StagePace:
        """Return the pace of the stage after this report."""
        pace = self._pace_of.get(stage)
        if pace is None or done < pace.done or total != pace.total:
            now, unit = (
                self.now(),
                "bytes" if self._is_bytes and not isinstance(stage, CountedStage) else unit_of(stage),
            )
            printed_at, printed = (now, done) if pace is None else (pace.printed_at, min(pace.printed, done))
            pace = self._pace_of[stage] = StagePace(now, done, unit, done, total, printed_at, printed)
        pace.done = done
        return pace


class ProgressLines:
    """Progress for logs and pipes: lines with time, title, units, rate and remaining time."""

    def __init__(self, write: Callable[[str], None], *, is_bytes: bool, now: Clock = datetime.now) -> None:
        self._write, self._paces, self._ended = write, StagePaces(is_bytes=is_bytes, now=now), dict[str, int]()

    def __call__(self, stage: str, done: int, total: int) -> None:
        pace, now = self._paces.after(stage, done, total), self._paces.now()
        if done < total:
            self._ended.pop(stage, None)
        if not total or self._ended.get(stage) == total or not pace.is_due(now):
            return
        if done >= total:
            self._ended[stage] = total
        pace.printed_at, pace.printed = now, done
        self._write(f"{now:%H:%M:%S} {title_of(stage)} {pace.figures(now)}")


class _Bars:
    def __init__(self, bars: Progress, *, is_bytes: bool) -> None:
        self._bars, self._paces = bars, StagePaces(is_bytes=is_bytes)
        self._task_of: dict[str, TaskID] = {}

    def __call__(self, stage: str, done: int, total: int) -> None:
        figures = self._paces.after(stage, done, total).figures(self._paces.now())
        if stage not in self._task_of:
            self._task_of[stage] = self._bars.add_task(title_of(stage), total=total, figures=figures)
        self._bars.update(self._task_of[stage], completed=done, total=total, figures=figures)


def title_of(stage: str) -> str:
    """Return the title of a stage for people."""
    return TITLES[stage][0] if stage in TITLES and not isinstance(stage, CountedStage) else str(stage)


def unit_of(stage: str) -> str:
    """Return the unit of a stage."""
    if isinstance(stage, CountedStage):
        return stage.unit
    return TITLES[stage][1] if stage in TITLES else "parts"


def bytes_of(done: int, total: int | None = None) -> str:
    """Return `12.4 GB`, or `12.4 of 50.0 GB` in the unit of the total."""
    largest = done if total is None else total
    size, unit = next(((size, unit) for size, unit in BYTE_UNITS if largest >= size), BYTE_UNITS[-1])
    digits = 0 if size == 1 or (total is None and done >= 10 * size) else 1
    count = f"{done / size:.{digits}f}"
    return f"{count} {unit}" if total is None else f"{count} of {total / size:.{digits}f} {unit}"


def duration(seconds: float) -> str:
    """Return `23 s`, `6 min` or `3 h 10 min`."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"
