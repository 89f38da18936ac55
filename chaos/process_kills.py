"""Kills of workers, Redis, the sweeper, PostgreSQL and S3 at chosen moments of a run."""

import os
import shutil
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from redis import RedisError

from chaos.turns import LOOK_S, OwnerRound
from services.runtime.jobs.broker_app import QUEUES
from services.runtime.jobs.wakeup import wake_up_counter
from services.runtime.orm import Job
from testing.process_states import children_of
from testing.process_tree import fork_servers_of, sandboxed_children_of
from testing.servers.process import ServerProcess

MOST_WAKE_UPS_RATIO = 0.7  # later jobs run one after another, and their wake-ups are received at once
APPEND_ONLY = ("appendonlydir", "appendonly.aof")  # since Redis 7, and before


def kill_worker(turn: OwnerRound, run_id: str) -> None:
    """Kill a pool process (a busy one, if any), the worker with its pool, the fork server, or one of its children."""
    victim_of = turn.chance.choice(["worker and pool", "pool process", "fork server", "sandboxed child"])
    turn.wait_for_moment(run_id)
    at_work = _await_work(turn, run_id)
    worker = turn.target.child("worker").pid
    apart = {"fork server": fork_servers_of, "sandboxed child": sandboxed_children_of}
    pool = [pid for pid in children_of(worker) if pid not in fork_servers_of(worker)]
    busy = [pid for pid in at_work if pid in pool]
    if victim_of in apart:
        victims = apart[victim_of](worker)
        turn.note(victim_of, is_hit=bool(busy and victims))
        with suppress(ProcessLookupError):
            for victim in victims[:1]:
                os.kill(victim, signal.SIGKILL)
    elif victim_of == "worker and pool" or not pool:
        turn.note("worker and pool", is_hit=bool(busy))
        turn.target.kill("worker")
    else:
        victim = turn.chance.choice(busy or pool)
        turn.note("pool process", is_hit=victim in busy)
        os.kill(victim, signal.SIGKILL)


def kill_redis(turn: OwnerRound, run_id: str) -> None:
    """Kill Redis while a wake-up is queued, after a random moment; in every second round it forgets all of them."""
    is_wiped = turn.chance.random() < 0.5
    turn.wait_for_moment(run_id, MOST_WAKE_UPS_RATIO)
    wake_ups = _waiting_wake_ups(turn)
    while not wake_ups and _is_running(turn, run_id):
        time.sleep(LOOK_S / 4)
        wake_ups = _waiting_wake_ups(turn)
    turn.note(f"{'wiped' if is_wiped else 'kept'}, {wake_ups} wake-ups", is_hit=wake_ups > 0)
    turn.target.kill("redis")
    if is_wiped:
        _wipe(turn.target.platform.settings.root / "redis")


def kill_sweeper(turn: OwnerRound, run_id: str) -> None:
    """Kill a busy process of the pool and soon after, before or while its job is resumed, the sweeper."""
    later_s = turn.chance.uniform(0.0, 1.5) * turn.target.platform.settings.jobs.lease_s
    turn.wait_for_moment(run_id)
    pool = children_of(turn.target.child("worker").pid)
    busy = [pid for pid in _await_work(turn, run_id) if pid in pool]
    if busy:
        os.kill(turn.chance.choice(busy), signal.SIGKILL)
        time.sleep(later_s)
    turn.note(f"{later_s:.1f} s after a pool process", is_hit=bool(busy) and _is_running(turn, run_id))
    turn.target.kill("sweeper")


def restart_s3(turn: OwnerRound, run_id: str) -> None:
    """Kill the store's server, and start it again after a while."""
    if (server := turn.target.s3) is None:
        raise ValueError("this platform has no S3 store")
    _restart(turn, run_id, server, server.kill)


def restart_postgres(turn: OwnerRound, run_id: str) -> None:
    """Stop it immediately, as in a crash, and start it again after a while."""
    if (server := turn.target.postgres) is None:
        raise ValueError("this platform has no PostgreSQL")
    _restart(turn, run_id, server, server.stop)


def _restart(turn: OwnerRound, run_id: str, server: ServerProcess, end: Callable[[], None]) -> None:
    """Stop a server by `end` while work is running, and start it again after a while."""
    away_s = turn.chance.uniform(0.0, 2.0)
    turn.wait_for_moment(run_id)
    turn.note(f"away for {away_s:.1f} s", is_hit=bool(_await_work(turn, run_id)))
    end()
    time.sleep(away_s)
    server.start()


def _await_work(turn: OwnerRound, run_id: str) -> list[int]:
    """Return the busy processes once there are any; an empty list if the run ended first."""
    while not (busy := turn.busy_processes()) and _is_running(turn, run_id):
        time.sleep(LOOK_S / 4)
    return busy


def _waiting_wake_ups(turn: OwnerRound) -> int:
    count = wake_up_counter(turn.target.platform.settings)
    try:
        return sum(count(queue) for queue in QUEUES)
    except (RedisError, OSError):
        return 0


def _is_running(turn: OwnerRound, run_id: str) -> bool:
    with turn.target.platform.database.reading() as session:
        return session.get_one(Job, run_id).state in ("queued", "running")


def _wipe(folder: Path) -> None:
    for name in APPEND_ONLY:
        path = folder / name
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
