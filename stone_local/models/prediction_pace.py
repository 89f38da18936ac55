"""The speed of a prediction: a bar on a terminal, a line every 10 s elsewhere; always on stderr."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from time import monotonic

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from stone_client.streams import is_progress_shown

LINE_EVERY_S = 10.0


@dataclass(frozen=True)
class PredictionPace:
    """`done` of `total` frames after `seconds`; `recorded_hz` is the recorded frame rate, None if it is undefined."""

    done: int
    total: int
    seconds: float
    recorded_hz: float | None

    @property
    def frames_per_s(self) -> float:
        return self.done / self.seconds if self.seconds > 0 else 0.0

    @property
    def real_time_ratio(self) -> float | None:
        """1 if frames are predicted as fast as they were recorded, more if faster."""
        return None if self.recorded_hz is None else self.frames_per_s / self.recorded_hz

    def __str__(self) -> str:
        ratio = "" if self.real_time_ratio is None else f", {self.real_time_ratio:.2f} × real time"
        return f"{self.frames_per_s:.2f} frames/s{ratio}"


@contextmanager
def prediction_shown() -> Iterator[Callable[[PredictionPace], None]]:
    """Yield the function that a prediction calls after each frame."""
    if not is_progress_shown():
        yield lambda _: None
        return
    console = Console(stderr=True, highlight=False)
    if not console.is_terminal:
        yield _PredictionLines(console)
        return
    columns = (TextColumn("predict"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=console) as bars:
        task = bars.add_task("", total=None)
        yield lambda pace: bars.update(task, completed=pace.done, total=pace.total, description=str(pace))


class _PredictionLines:
    """A line every ten seconds, and the last one."""

    def __init__(self, console: Console) -> None:
        self._console, self._said_at = console, float("-inf")

    def __call__(self, pace: PredictionPace) -> None:
        if monotonic() - self._said_at > LINE_EVERY_S or pace.done == pace.total:
            self._said_at = monotonic()
            self._console.print(f"predict {pace.done}/{pace.total} {pace}", markup=False)
