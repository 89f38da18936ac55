"""Training progress: a bar on a terminal, a line every 10 s elsewhere; always on stderr."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from time import monotonic
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from stone_client.streams import is_progress_shown

LINE_EVERY_S = 10.0


class StepReport(Protocol):
    """The shown fields of `baselines.run_folder.TrainingReport`."""

    @property
    def step(self) -> int: ...
    @property
    def steps(self) -> int: ...
    @property
    def epoch(self) -> int: ...
    @property
    def loss(self) -> float: ...
    @property
    def losses(self) -> Mapping[str, float]: ...
    @property
    def scores(self) -> Mapping[str, float | None]: ...
    @property
    def frames_per_s(self) -> float: ...
    @property
    def left_s(self) -> float: ...
    @property
    def watched(self) -> bool: ...


@contextmanager
def training_shown() -> Iterator[Callable[[StepReport], None]]:
    """Yield the function that training calls after each step."""
    if not is_progress_shown():
        yield lambda _: None
        return
    console = Console(stderr=True, highlight=False)
    if not console.is_terminal:
        yield _TrainingLines(console)
        return
    columns = (TextColumn("train"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=console) as bars:
        task = bars.add_task("", total=None)

        def show(report: StepReport) -> None:
            if report.watched:
                bars.console.print(watched_line(report))
            else:
                bars.update(task, completed=report.step, total=report.steps, description=rate_of(report))

        yield show


class _TrainingLines:
    """A line for each validation, one every ten seconds for steps, and the last."""

    def __init__(self, console: Console) -> None:
        self._console, self._said_at = console, float("-inf")

    def __call__(self, report: StepReport) -> None:
        if report.watched:
            self._console.print(watched_line(report))
        elif monotonic() - self._said_at > LINE_EVERY_S or report.step == report.steps:
            self._said_at = monotonic()
            self._console.print(f"step {report.step}/{report.steps} {rate_of(report)}")


def rate_of(report: StepReport) -> str:
    """Return the losses, the metric if this step measured it, the rate and the time left."""
    terms = "  ".join(f"{name} {value:.3f}" for name, value in report.losses.items())
    parts = [f"loss {report.loss:.3f}", *([f"({terms})"] if terms else []), *scores_said(report.scores)]
    if report.frames_per_s:
        minutes, seconds = divmod(round(report.left_s), 60)
        parts.append(f"{report.frames_per_s:.2f} frames/s, {minutes}:{seconds:02} left")
    return "  ".join(parts)


def watched_line(report: StepReport) -> str:
    """Return the scores of the validation sequences after an epoch."""
    return f"epoch {report.epoch + 1}, validation: {'  '.join(scores_said(report.scores))}"


def scores_said(scores: Mapping[str, float | None]) -> list[str]:
    """Return ratios in per cent, a dash for None."""
    return [f"{name} {'—' if value is None else f'{100 * value:.1f} %'}" for name, value in scores.items()]
