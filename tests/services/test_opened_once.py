"""A job and a command open each recording once, whatever they want of it.

Catches alone a job that opens its recording once for each purpose and takes twice the time.
"""

import mmap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from services.domain.exports.requests import EXPORT, start_export
from services.domain.sequences.processing import CHECK, REGISTER, SYNCHRONISE
from services.runtime.jobs.specs import Attempt, Handler, Outcome
from services.runtime.platform import Platform
from simulator.pipeline import calibration_path
from stone_recordings.bags.bag import Bag
from stone_recordings.sync import sweeps
from testing.worlds.drives import SHORT, drive
from testing.worlds.runs import bring, run_all

pytestmark = pytest.mark.release

Opens = Callable[[], int]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory, SHORT)


@pytest.fixture
def opens(monkeypatch: pytest.MonkeyPatch) -> Opens:
    """How many recordings were opened since it was last asked, by this process and by children that it forked."""
    count, init = mmap.mmap(-1, 8), Bag.__init__  # shared memory: a confined child may write to no file of ours

    def opening(self: Bag, *rest: Any) -> None:
        count[0] += 1
        init(self, *rest)

    def asked() -> int:
        opened, count[0] = count[0], 0
        return opened

    monkeypatch.setattr(Bag, "__init__", opening)
    sweeps._opened_once.cache_clear()
    return asked


@pytest.fixture
def by_kind(platform: Platform, bag: Path, opens: Opens) -> dict[str, list[int]]:
    """How often each job of a kind opened the recording: from its registration to its labels and an export."""
    found: dict[str, list[int]] = {}

    def counting(kind: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            sweeps._opened_once.cache_clear()  # as in a process that has seen no job yet
            opens()
            outcome = handler(attempt)
            found.setdefault(kind, []).append(opens())
            return outcome

        return run

    brought = bring(platform)
    brought.calibrate(calibration_path(bag))
    brought.add(bag)
    run_all(platform, wrap=counting)
    brought.process()
    run_all(platform, wrap=counting)
    with platform.database.transaction() as session:
        start_export(session, brought.sequence(), "nuscenes")
    run_all(platform, wrap=counting)
    return found


def test_a_job_opens_its_recording_once(by_kind: dict[str, list[int]]) -> None:
    assert {REGISTER, SYNCHRONISE, CHECK, "labeler.fuse", "labeler.frames", EXPORT} <= by_kind.keys()
    reads = (REGISTER, SYNCHRONISE, CHECK, "labeler.fuse", EXPORT)
    assert {kind: set(counts) for kind, counts in by_kind.items()} == {
        kind: {1} if kind in reads else {0} for kind in by_kind
    }
