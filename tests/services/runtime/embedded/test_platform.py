"""The embedded platform as a user has it: what dies comes back, what was cut off resumes, nothing is left behind.

Catches alone what the real processes of one machine do to each other when one of them ends.
"""

import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import psutil
import pytest

from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from stone_client.files.bags import hashed_bag
from stone_client.server.job_following import follow
from stone_client.server.sequences import add_recording, ensure_sequence, pin_calibration, start_run
from testing.stone_serve import STONE, Serving, environment, is_alive, serving, until

pytestmark = pytest.mark.whole
Up = Callable[[], Serving]


def quiet(stage: str, done: int, total: int) -> None:
    """Tests watch nothing."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("embedded") / "with spaces"


@pytest.fixture(scope="module")
def up(folder: Path) -> Iterator[Up]:
    """The platform, started (again) when it is not up."""
    folder.mkdir()
    with ExitStack() as stack:
        running: list[Serving] = []

        def ensure() -> Serving:
            if not running or running[-1].process.poll() is not None:
                running.append(stack.enter_context(serving(folder / "the data")))
            return running[-1]

        yield ensure


@pytest.fixture(scope="module")
def sequence(up: Up, folder: Path) -> dict[str, Any]:
    """A sequence with everything that processing needs."""
    bag = folder / "run.mcap"
    simulate(bag, SimulateOptions(seconds=3.0, channels=16, columns=180, cameras=False))
    with up().api() as api:
        made = dict(ensure_sequence(api, "run"))
        pin_calibration(api, made, calibration_path(bag))
        add_recording(api, made, hashed_bag(bag, quiet), quiet)
    return made


def begin(serving: Serving, sequence: dict[str, Any], neighbours: int) -> str:
    """A run of its own, by a parameter of its own; its id once some of its jobs have ended and some run."""
    with serving.api() as api:
        run = start_run(api, sequence, {"parameters": {"terrain.neighbours": neighbours}})

        def is_under_way() -> bool:
            stages = api.read(f"/jobs/{run['id']}")["stages"]
            return any(stage["done"] for stage in stages) and any(stage["running"] for stage in stages)

        until(is_under_way)
    return str(run["id"])


def outcomes(serving: Serving, run_id: str) -> set[str]:
    """How the attempts of the run's jobs ended."""
    with serving.api() as api:
        jobs = [api.read(f"/jobs/{job['id']}") for job in api.pages("/jobs", root_id=run_id)]
    return {attempt["outcome"] for job in jobs for attempt in job["attempts"]}


@pytest.mark.release
def test_a_taken_port_is_refused_by_name_and_nothing_is_started(up: Up, tmp_path: Path) -> None:
    """Catches alone a platform that begins processes before it has its port."""
    port = up().url.rpartition(":")[2]
    command = [*STONE, "serve", "--data", tmp_path / "other", "--port", port]
    refused = subprocess.run(
        command, env=environment(tmp_path / "other"), check=False, capture_output=True, text=True, timeout=300
    )
    assert refused.returncode == 1
    assert refused.stderr.startswith("port_taken: ")
    assert [path.name for path in (tmp_path / "other").iterdir()] == ["server.lock"]


def test_the_secrets_are_for_the_owners_eyes_only(up: Up) -> None:
    data = up().data
    for name in ("admin-password", "local-token", "redis/redis.conf"):
        assert (data / name).stat().st_mode & 0o077 == 0, name


def test_the_password_is_said_at_the_first_start_only(up: Up) -> None:
    first = up()
    password = (first.data / "admin-password").read_text().strip()
    assert first.said.read_text().count(password) == 1


def test_a_redis_that_is_killed_comes_back_and_jobs_go_on(up: Up, sequence: dict[str, Any]) -> None:
    running = up()
    run_id = begin(running, sequence, 20)
    running.child("redis").kill()
    with running.api() as api:
        assert follow(api, run_id, quiet)["state"] == "succeeded"
    assert outcomes(running, run_id) == {"succeeded"}, "no attempt was lost with the broker"


def test_a_worker_that_is_killed_leaves_no_process_behind_and_its_jobs_are_done_again(
    up: Up, sequence: dict[str, Any]
) -> None:
    running = up()
    run_id = begin(running, sequence, 21)
    worker = running.child("processes.worker")
    pool = worker.children(recursive=True)
    assert len(pool) >= 2
    worker.kill()
    until(lambda: not any(is_alive(one) for one in pool))
    with running.api() as api:
        assert follow(api, run_id, quiet)["state"] == "succeeded"


def test_a_supervisor_killed_by_kill_9_leaves_nothing_and_the_next_start_resumes(
    up: Up, sequence: dict[str, Any]
) -> None:
    running = up()
    run_id = begin(running, sequence, 22)
    below = running.descendants()
    assert len(below) >= 6, "redis, api, sweeper, worker and its two processes"
    running.kill_9()
    assert not any(is_alive(one) for one in below)
    again = up()
    with again.api() as api:
        assert follow(api, run_id, quiet)["state"] == "succeeded"


def test_a_stop_drains_leaves_nothing_and_costs_no_attempt(up: Up, sequence: dict[str, Any]) -> None:
    running = up()
    run_id = begin(running, sequence, 23)
    below = running.descendants()
    assert running.stop() == 0
    assert not any(is_alive(one) for one in below)
    again = up()
    with again.api() as api:
        assert follow(api, run_id, quiet)["state"] == "succeeded"
        jobs = [api.read(f"/jobs/{job['id']}") for job in api.pages("/jobs", root_id=run_id)]
    assert all(job["attempts_left"] == 2 for job in jobs), "each job has used one of its three attempts"


def test_nothing_of_another_user_or_machine_can_be_reached(up: Up) -> None:
    connections = list[Any]()
    for one in up().descendants():
        with suppress(psutil.NoSuchProcess):  # a sandboxed child that ended meanwhile
            connections += one.net_connections("tcp")
    listening = [connection for connection in connections if connection.status == psutil.CONN_LISTEN]
    assert {connection.laddr.ip for connection in listening} == {"127.0.0.1"}
