"""Lines of progress in logs and pipes: how often, with which title, unit, rate and remaining time."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from datetime import datetime, timedelta
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import pytest

from services.runtime.jobs.queries import TITLES as PAGE_TITLES
from stone_client.progress import CountedStage, ProgressLines, bytes_of, duration, reported, transferred
from stone_client.server.job_following import _report
from stone_client.streams import choose_output
from stone_local.models.prediction_pace import PredictionPace, prediction_shown
from stone_local.models.training_progress import training_shown
from tests.stone_client.participating import stone

GB = 10**9


class Watch:
    """A clock that stands still until it is moved."""

    def __init__(self) -> None:
        self.now = datetime(2026, 11, 30, 12, 0, 0)

    def __call__(self) -> datetime:
        return self.now

    def wait(self, seconds: float) -> None:
        self.now += timedelta(seconds=seconds)


@pytest.fixture
def watch() -> Watch:
    return Watch()


def test_a_long_upload_has_a_line_every_ten_seconds_with_rate_and_time_left(watch: Watch) -> None:
    lines: list[str] = []
    progress = ProgressLines(lines.append, is_bytes=True, now=watch)
    for second in range(501):
        progress("upload", second * GB // 10, 50 * GB)
        watch.wait(1)
    assert lines[0] == "12:00:10 Upload 1.0 of 50.0 GB, 100 MB/s, 8 min left"
    assert lines[-1] == "12:08:20 Upload 50.0 of 50.0 GB, done in 8 min"
    times = [datetime.strptime(line[:8], "%H:%M:%S") for line in lines]
    assert all((after - before).total_seconds() == 10 for before, after in pairwise(times))


def test_a_stage_of_a_minute_has_a_line_every_tenth(watch: Watch) -> None:
    lines: list[str] = []
    progress = ProgressLines(lines.append, is_bytes=False, now=watch)
    for done in range(201):
        progress(CountedStage("Label frames", "jobs"), done, 200)
        watch.wait(0.25)
    assert lines[0] == "12:00:05 Label frames 20 of 200 jobs, 4/s, 45 s left"
    assert len(lines) == 10


def test_a_stage_of_a_moment_has_one_line_and_its_repetition_none(watch: Watch) -> None:
    lines: list[str] = []
    progress = ProgressLines(lines.append, is_bytes=False, now=watch)
    for done in (0, 1, 2, 3, 3, 3):
        progress("predict", done, 3)
    assert lines == ["12:00:00 Predict frames 3 of 3 frames"]
    for done in (0, 3):
        progress("predict", done, 3)
    assert len(lines) == 2, "a stage that began again ends again"


def test_an_upload_that_resumes_counts_its_rate_from_there(watch: Watch) -> None:
    lines: list[str] = []
    progress = ProgressLines(lines.append, is_bytes=True, now=watch)
    progress("upload", 40 * GB, 50 * GB)
    watch.wait(10)
    progress("upload", 41 * GB, 50 * GB)
    assert lines == ["12:00:10 Upload 41.0 of 50.0 GB, 100 MB/s, 2 min left"]


def test_a_job_counts_also_in_a_command_that_transfers_bytes(watch: Watch) -> None:
    lines: list[str] = []
    progress = ProgressLines(lines.append, is_bytes=True, now=watch)
    job = {
        "kind": "ingest.register",
        "title": "Read the recording",
        "progress": {"stage": "keep", "done": 4, "total": 4},
    }
    _report(job, {}, progress)
    assert lines == ["12:00:00 Read the recording 4 of 4 steps"]


def test_stages_of_a_run_have_the_titles_of_the_pages() -> None:
    seen: list[str] = []
    stages = [
        {"kind": kind, "title": title, "done": 1, "total": 2} for kind, title in PAGE_TITLES.items() if "." in kind
    ]
    _report(
        {"kind": "sequence.process", "stages": stages, "progress": {"stage": ""}},
        {},
        lambda *step: seen.append(step[0]),
    )
    assert seen == [stage["title"] for stage in stages]
    assert not [title for title in seen if "." in title]


@pytest.mark.parametrize(
    ("done", "total", "told"),
    [(0, 0, "0 of 0 bytes"), (999, 999, "999 of 999 bytes"), (12_400_000_000, 50 * GB, "12.4 of 50.0 GB"),
     (10**12, 2 * 10**12, "1.0 of 2.0 TB"), (1_500, 2_000, "1.5 of 2.0 kB"), (95_000_000, None, "95 MB"),
     (9_500_000, None, "9.5 MB"), (7, None, "7 bytes")],
)  # fmt: skip
def test_bytes_are_told_in_the_unit_of_the_total(done: int, total: int | None, told: str) -> None:
    assert bytes_of(done, total) == told


@pytest.mark.parametrize(
    ("seconds", "told"), [(0.2, "0 s"), (89, "89 s"), (91, "2 min"), (5_339, "89 min"), (11_400, "3 h 10 min")]
)
def test_durations_have_one_unit_or_hours_and_minutes(seconds: float, told: str) -> None:
    assert duration(seconds) == told


@pytest.mark.parametrize("option", ["--quiet", "--no-progress"])
def test_progress_is_turned_off_before_and_after_the_word_of_the_command(option: str) -> None:
    def shown() -> bool:
        with reported() as progress:
            return isinstance(progress, ProgressLines)

    assert stone("explain", "LAB-603").exit_code == 0
    assert shown()
    for words in ([option, "explain", "LAB-603"], ["explain", "LAB-603", option]):
        assert stone(*words).exit_code == 0
        assert not shown()
    assert stone("explain", "LAB-603").exit_code == 0
    assert shown()


def test_a_terminal_has_a_bar_with_the_same_title_and_figures(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "120")
    with transferred() as progress:
        progress("upload", 10**9, 2 * 10**9)
        progress(CountedStage("Read the [recording]", "steps"), 4, 4)
    shown = capsys.readouterr()
    assert shown.out == ""
    for word in ("Upload", "1.0 of 2.0 GB", "Read the [recording]", "4 of 4 steps"):
        assert word in shown.err


@pytest.mark.parametrize("pace", [training_shown, prediction_shown])
def test_training_and_prediction_are_silent_too(
    pace: Callable[[], AbstractContextManager[Callable[[Any], None]]], capsys: pytest.CaptureFixture[str]
) -> None:
    reports: dict[Any, Any] = {
        training_shown: SimpleNamespace(
            step=3, steps=3, epoch=0, loss=1.0, losses={}, scores={}, frames_per_s=1.0, left_s=0.0, watched=False
        ),
        prediction_shown: PredictionPace(3, 3, 1.0, None),
    }
    for is_quiet, is_shown in ((False, True), (True, False), (False, True)):
        choose_output(is_quiet=is_quiet, has_progress=True)
        with pace() as show:
            show(reports[pace])
        assert bool(capsys.readouterr().err) == is_shown
