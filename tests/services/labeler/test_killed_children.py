"""What kills a labeller's child on a platform of real processes costs that job one attempt and nothing else.

Catches alone a worker or a pool that ends with its sandboxed child, and what it makes of the recording by which one of
the command's processes was once killed by SIGBUS.
"""

import os
import signal
from collections.abc import Iterator
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from stone_client.api import Api
from stone_client.files.bags import hashed_bag
from stone_client.server.job_following import TERMINAL, follow
from stone_client.server.sequences import add_recording, ensure_sequence, pin_calibration, start_run
from testing.process_states import children_of, is_running
from testing.process_tree import fork_servers_of, sandboxed_children_of
from testing.stone_serve import Serving, serving, until
from testing.worlds.hostile_drive import ATTACKS, attacked, sound_drive, write_drive

pytestmark = pytest.mark.whole
OVERFLOWING = "points that overflow as they are turned"
STAGE, WORKERS = "labeler.surface", 2
KEEPERS = 1  # of leases, forked before the pool
NEIGHBOURS = count(12)  # each makes a run of its own


def quiet(stage: str, done: int, total: int) -> None:
    """Tests watch nothing."""


@pytest.fixture(scope="module")
def platform(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Serving]:
    with serving(tmp_path_factory.mktemp("killed") / "data") as running:
        until(lambda: len(pool_of(running)) == 1 + KEEPERS + WORKERS)
        yield running


@pytest.fixture
def api(platform: Serving) -> Iterator[Api]:
    with platform.api() as connected:
        yield connected


@pytest.fixture(scope="module")
def sound(platform: Serving, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """A sequence that nobody was hostile to."""
    with platform.api() as api:
        return brought(api, "sound", write_drive(sound_drive(), tmp_path_factory.mktemp("sound")))


def brought(api: Api, name: str, files: tuple[Path, Path]) -> dict[str, Any]:
    """A sequence with the recording and its calibration."""
    bag, calibration = files
    sequence = dict(ensure_sequence(api, name))
    pin_calibration(api, sequence, calibration)
    add_recording(api, sequence, hashed_bag(bag, quiet), quiet)
    return sequence


def jobs_of(api: Api, run_id: str) -> list[dict[str, Any]]:
    return [dict(api.read(f"/jobs/{job['id']}")) for job in api.pages("/jobs", root_id=run_id)]


def pool_of(platform: Serving) -> set[int]:
    """The worker, the process that keeps its leases, and those of its pool."""
    worker = platform.child("processes.worker").pid
    return {worker, *children_of(worker)} - set(fork_servers_of(worker))


def started(api: Api, sequence: dict[str, Any]) -> str:
    """The id of a run that was not there before."""
    return str(start_run(api, sequence, {"parameters": {"terrain.neighbours": next(NEIGHBOURS)}})["id"])


def strike(api: Api, platform: Serving, run_id: str, death: int) -> bool:
    """Send a child the signal while the stage is at work, and wait for the run's end; whether there was one."""
    until(lambda: bool(at_work(api, run_id) or has_ended(api, run_id)))
    struck = sandboxed_children_of(platform.child("processes.worker").pid)[:1]
    for child in struck:
        with suppress(ProcessLookupError):
            os.kill(child, death)
    until(lambda: has_ended(api, run_id))
    return bool(struck)


def outcomes(api: Api, run_id: str) -> list[list[str]]:
    """How the attempts at each job ended."""
    return [[one["outcome"] for one in job["attempts"]] for job in jobs_of(api, run_id) if job["attempts"]]


def at_work(api: Api, run_id: str) -> list[Any]:
    return [stage for stage in api.read(f"/jobs/{run_id}")["stages"] if stage["kind"] == STAGE and stage["running"]]


def has_ended(api: Api, run_id: str) -> bool:
    return api.read(f"/jobs/{run_id}")["state"] in TERMINAL


def test_the_recording_that_killed_the_command_is_labelled_at_the_first_attempt(
    api: Api, platform: Serving, tmp_path: Path
) -> None:
    pool = pool_of(platform)
    sequence = brought(api, "hostile", write_drive(attacked(*ATTACKS[OVERFLOWING]), tmp_path))
    run = follow(api, start_run(api, sequence, {})["id"], quiet)
    report = api.read(f"/sequences/{sequence['id']}/report")
    assert (run["state"], report["frames"], report["map"]["far_points"]) == ("succeeded", 8, 512)
    assert "LAB-608" in {finding["code"] for finding in report["findings"]}
    assert {job["attempt"] for job in jobs_of(api, run["id"])} == {1}
    assert pool_of(platform) == pool


def test_a_child_killed_from_outside_costs_one_attempt_and_the_run_succeeds(
    api: Api, platform: Serving, sound: dict[str, Any]
) -> None:
    """A child that waits for its next job takes no attempt along: another run is tried then."""
    pool, tries = pool_of(platform), list[list[str]]()
    while not any("lost" in of_job for of_job in tries):
        run_id = started(api, sound)
        strike(api, platform, run_id, signal.SIGKILL)
        tries = outcomes(api, run_id)
        assert api.read(f"/jobs/{run_id}")["state"] == "succeeded"
    assert [of_job for of_job in tries if len(of_job) > 1] == [["lost", "succeeded"]]
    assert pool_of(platform) == pool
    assert all(map(is_running, pool))


def test_a_child_that_the_kernel_kills_costs_its_run_at_most_and_the_next_run_succeeds(
    api: Api, platform: Serving, sound: dict[str, Any]
) -> None:
    """One that did earlier jobs of the run is replaced on the spot; a fresh one would break by the same bytes again."""
    pool, run_id = pool_of(platform), started(api, sound)
    while not strike(api, platform, run_id, signal.SIGBUS):
        run_id = started(api, sound)
    run, tries = api.read(f"/jobs/{run_id}"), outcomes(api, run_id)
    if run["state"] == "failed":
        assert run["failure"]["code"] == "reader_crashed"
        assert "was ended by SIGBUS" in str(run["failure"])
        assert [of_job for of_job in tries if of_job != ["succeeded"]] == [["failed"]]
    else:
        assert run["state"] == "succeeded"
        assert all(of_job == ["succeeded"] for of_job in tries)
    assert follow(api, started(api, sound), quiet)["state"] == "succeeded"
    assert pool_of(platform) == pool
    assert all(map(is_running, pool))
