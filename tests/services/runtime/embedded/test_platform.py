"""The embedded platform as a user has it: what dies comes back, what was cut off resumes, nothing is left behind.

Catches alone what the real processes of one machine do to each other when one of them ends.
"""

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
from testing.stone_serve import Serving, is_alive, serving, until

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


def jobs_of(serving: Serving, run_id: str) -> list[Any]:
    with serving.api() as api:
        return [api.read(f"/jobs/{job['id']}") for job in api.pages("/jobs", root_id=run_id)]


def stages(serving: Serving, run_id: str, of: str) -> int:
    """How many jobs of the run are so: `done`, `running`."""
    with serving.api() as api:
        return sum(stage[of] for stage in api.read(f"/jobs/{run_id}")["stages"])


def begin(serving: Serving, sequence: dict[str, Any], neighbours: int) -> str:
    """A run of its own, by a parameter of its own; its id once some of its jobs have ended and some run."""
    with serving.api() as api:
        run_id = str(start_run(api, sequence, {"parameters": {"terrain.neighbours": neighbours}})["id"])
    until(lambda: all(stages(serving, run_id, of) for of in ("done", "running")))
    return run_id


def goes_on(serving: Serving, run_id: str) -> None:
    """Wait for one more of its jobs to end."""
    before = stages(serving, run_id, "done")
    until(lambda: stages(serving, run_id, "done") > before)


def succeeds(serving: Serving, run_id: str) -> bool:
    with serving.api() as api:
        return bool(follow(api, run_id, quiet)["state"] == "succeeded")


def test_what_is_secret_is_for_its_owner_and_nothing_listens_beyond_this_machine(up: Up) -> None:
    first = up()
    for name in ("admin-password", "local-token", "redis/redis.conf"):
        assert (first.data / name).stat().st_mode & 0o077 == 0, name
    connections = list[Any]()
    for one in first.descendants():
        with suppress(psutil.NoSuchProcess):  # a sandboxed child that ended meanwhile
            connections += one.net_connections("tcp")
    listening = [connection for connection in connections if connection.status == psutil.CONN_LISTEN]
    assert {connection.laddr.ip for connection in listening} == {"127.0.0.1"}


def test_a_run_goes_on_when_redis_is_killed_and_then_a_worker_which_leaves_no_process_behind(
    up: Up, sequence: dict[str, Any]
) -> None:
    running = up()
    run_id = begin(running, sequence, 20)
    running.child("redis").kill()
    goes_on(running, run_id)
    outcomes = {attempt["outcome"] for job in jobs_of(running, run_id) for attempt in job["attempts"]}
    assert outcomes <= {"", "succeeded"}, "no attempt was lost with the broker"
    worker = running.child("processes.worker")
    pool = worker.children(recursive=True)
    assert len(pool) >= 2
    worker.kill()
    until(lambda: not any(is_alive(one) for one in pool))
    assert succeeds(running, run_id)


def test_a_run_is_resumed_after_a_stop_which_costs_no_attempt_and_after_kill_9_which_leaves_nothing(
    up: Up, sequence: dict[str, Any]
) -> None:
    running = up()
    run_id = begin(running, sequence, 21)
    below = running.descendants()
    assert len(below) >= 6, "redis, api, sweeper, worker and its two processes"
    assert running.stop() == 0
    assert not any(is_alive(one) for one in below)
    again = up()
    goes_on(again, run_id)
    begun = [job["attempts_left"] for job in jobs_of(again, run_id) if job["state"] in ("running", "succeeded")]
    assert set(begun) == {2}, "each has used one of its three attempts"
    below = again.descendants()
    again.kill_9()
    assert not any(is_alive(one) for one in below)
    assert succeeds(up(), run_id)
    password = (again.data / "admin-password").read_text().strip()
    assert again.output.read_text().count(password) == 1, "it is said at the first start only"
