"""The clients of the load benchmark against the real application: what they ask is answered, or told."""

import asyncio
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.load.__main__ import clients
from benchmarks.load.clients import READS, LoadLog, LoadPlan, all_live
from services.runtime.orm import SequenceRow
from services.runtime.platform import Platform
from testing.api.serving import Person, person, serving

LIVES_S = 0.5


@pytest.fixture
def curator(platform: Platform) -> Person:
    return person(platform, "curator")


@pytest.fixture
def plan(platform: Platform, curator: Person, tmp_path: Path) -> LoadPlan:
    """A reader and somebody who sends files; where is not said yet."""
    with platform.database.transaction() as session:
        sequence = SequenceRow(owner_id=curator.user_id, name="forest")
        session.add(sequence)
        session.flush()
        return LoadPlan(
            port=0,
            seconds=LIVES_S,
            pause_s=0.0,
            readers=1,
            uploaders=1,
            submitters=0,
            secrets=(curator.secret,),
            captains=(),
            sequence=sequence.id,
            benchmark="none",
            phase="val",
            phase_id="",
            zip_path="",
        )


def lived(platform: Platform, plan: LoadPlan) -> LoadLog:
    with serving(platform) as url:
        return lived_at(replace(plan, port=int(url.rpartition(":")[2])))


def test_what_a_process_of_clients_noted_is_read_again(platform: Platform, plan: LoadPlan, tmp_path: Path) -> None:
    with serving(platform) as url:
        noted = clients(tmp_path, replace(plan, port=int(url.rpartition(":")[2])))
    assert noted["waited_s"].keys() >= {"upload: announce"}
    assert noted["error_count"] >= len(noted["errors"])


def lived_at(plan: LoadPlan) -> LoadLog:
    """In a thread of its own: a browser of this process may have left its loop in this one."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(lambda: asyncio.run(all_live(plan))).result()


def test_what_is_asked_is_timed_and_a_refusal_is_an_error_with_its_words(platform: Platform, plan: LoadPlan) -> None:
    noted = lived(platform, plan)
    assert {"upload: announce", "upload: PATCH of 1 MiB"} <= noted.waited_s.keys()
    assert noted.waited_s.keys() & {what for what, *_ in READS}
    refused = [words for words in noted.errors if not words.startswith("the board: 404")]
    assert refused == [], "there is no such board, and nothing else is refused"
    assert noted.error_count == len(noted.waited_s.get("the board", []))


def test_a_server_that_is_not_there_is_an_error_and_no_end(platform: Platform, plan: LoadPlan) -> None:
    noted = lived_at(replace(plan, port=1, seconds=0.05))
    assert noted.error_count > 0
    assert "ConnectionRefusedError" in noted.errors[0]
