"""An import on its own platform that is killed at moments spread over the frames."""

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from threading import Event, Thread
from typing import Any

import psutil

from benchmarks.season.people import signed_in
from services.runtime.embedded.first_start import ADMINISTRATOR, PASSWORD_FILE
from stone_client.api import Api
from stone_client.errors import ServerUnreachableError
from stone_client.sdk import ignore_progress
from stone_client.server.dataset_imports import DatasetWishes, read_import, send_dataset
from testing.stone_serve import Serving, serving

LOOK_S = 0.5
MIB = 2**20
WISHES = DatasetWishes("release", sets_splits=True)
GONE = (psutil.NoSuchProcess, psutil.AccessDenied, psutil.ZombieProcess)
ROLES = ("sandbox.fork_server", "processes.worker", "sweeper", "processes.api", "redis-server")


@dataclass
class ImportMeasurement:
    """A successful import: its duration from the request, and the peak memory of each process."""

    sent_s: float = 0.0
    wall_s: float = 0.0
    frames: int = 0
    kills: int = 0
    most_mib: dict[str, float] = field(default_factory=dict)


class ImportFailedError(Exception):
    """The import did not succeed."""


def imported(data: Path, tar: Path, kills: int, seed: int = 1) -> ImportMeasurement:
    """Upload the tar, import it, and kill its processes. Raises `ImportFailedError`."""
    made, chance = ImportMeasurement(), Random(seed)
    begun = time.perf_counter()
    with serving(data) as running, administrator(running) as api:
        accepted = send_dataset(api, tar, WISHES, ignore_progress)
    made.sent_s = time.perf_counter() - begun
    begun, state = time.perf_counter(), dict[str, Any](accepted)
    while state["state"] not in ("succeeded", "failed", "cancelled"):
        with serving(data) as running, _memory_seen(running, made.most_mib):
            state = _disturbed(running, str(accepted["id"]), (made, kills, chance))
    if state["state"] != "succeeded":
        raise ImportFailedError(f"{state['state']}: {state['failure']}")
    made.wall_s, made.frames = time.perf_counter() - begun, int(state["frames"])
    return made


def administrator(running: Serving) -> Api:
    """Return the platform's API for its administrator, who may set splits and open phases."""
    return signed_in(running.url, ADMINISTRATOR, (running.data / PASSWORD_FILE).read_text().strip())


def _disturbed(running: Serving, import_id: str, plan: tuple[ImportMeasurement, int, Random]) -> dict[str, Any]:
    """Return the import after it has ended, or after the whole platform was killed."""
    made, kills, chance = plan
    with administrator(running) as api:
        while True:
            with suppress(ServerUnreachableError):
                state = dict(read_import(api, import_id))
                if state["state"] in ("succeeded", "failed", "cancelled"):
                    return state
                if _is_due(state, made.kills, kills):
                    made.kills += 1
                    time.sleep(chance.uniform(0.0, 2.0))
                    if made.kills % 2:
                        running.kill_9()
                        return state
                    _kill_in_worker(running, chance)
            time.sleep(LOOK_S)


def _is_due(state: dict[str, Any], done: int, kills: int) -> bool:
    """Return whether a kill is due: kill k of n comes after a share of the scenes, the first before the index is
    complete.
    """
    if done >= kills:
        return False
    if not done:
        return True
    total = state["scenes_total"]
    return total is not None and int(state["scenes_done"]) >= total * (done - 1) / kills


def _kill_in_worker(running: Serving, chance: Random) -> None:
    """Kill one process below the worker: a pool process, a sandboxed child, or their fork server."""
    below = running.child("processes.worker").children(recursive=True)
    with suppress(*GONE):
        if below:
            chance.choice(below).kill()


@contextmanager
def _memory_seen(running: Serving, most_mib: dict[str, float]) -> Iterator[None]:
    """Record the peak resident memory of any process of each role while the block runs."""
    ended = Event()
    thread = Thread(target=_look, args=(running, most_mib, ended), daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _look(running: Serving, most_mib: dict[str, float], ended: Event) -> None:
    while not ended.wait(LOOK_S):
        with suppress(*GONE):
            for process in running.descendants():
                with suppress(*GONE):
                    words = " ".join(process.cmdline())
                    role = next((role for role in ROLES if role in words), "other")
                    most_mib[role] = max(most_mib.get(role, 0.0), process.memory_info().rss / MIB)
