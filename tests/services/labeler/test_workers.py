"""Workers do every task, pass errors on, and do not outlive who asked for them."""

import gc
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from services.labeler.errors import NoUsableFramesError
from services.labeler.workers import Task, Workers
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration
from stone.sensors.sequence import Frames, Sequence
from stone_base.garbage import COLLECTED_AFTER
from testing.signals import hear_signals

ROOT = Path(__file__).resolve().parents[3]
ENDLESS = """
import os, time
from services.labeler.workers import Task, Workers
from tests.services.labeler.test_workers import pid_then_sleep
if __name__ == "__main__":
    with Workers(2) as workers:
        tasks = [Task((n,), pid_then_sleep, (s,)) for n, s in enumerate((0.0, 0.0, 600.0, 600.0))]
        for _, done in workers.run(tasks):
            print(done.pid, flush=True)
"""


def square(number: int) -> int:
    time.sleep(0.05 * (3 - number))
    return number * number


def pid_then_sleep(seconds: float) -> int:
    time.sleep(seconds)
    return os.getpid()


def refuse(name: str) -> None:
    import numpy as np

    frames = Frames(np.zeros(0, np.int64), (), SE3.identity((0,)))
    raise NoUsableFramesError(Sequence(name, frames, (), Calibration("rig", SE3.identity()), "none"))


def test_every_task_is_done_and_says_what_it_came_to() -> None:
    with Workers(2) as workers:
        done = {task.key: result.value for task, result in workers.run([Task((n,), square, (n,)) for n in range(3)])}
    assert done == {(0,): 0, (1,): 1, (2,): 4}


def test_a_refusal_in_a_worker_reaches_the_caller_as_it_was() -> None:
    with Workers(1) as workers, pytest.raises(NoUsableFramesError, match=r"sequence run has no usable frame"):
        list(workers.run([Task(("refused",), refuse, ("run",))]))


def test_a_failure_does_not_wait_for_the_other_tasks() -> None:
    begin = time.monotonic()
    tasks = [Task((seconds,), _refuse_or_sleep, (seconds,)) for seconds in (0.0, 600.0)]
    with pytest.raises(NoUsableFramesError), Workers(2) as workers:
        list(workers.run(tasks))
    assert time.monotonic() - begin < 300


def _refuse_or_sleep(seconds: float) -> None:
    time.sleep(seconds)
    refuse("run")


def _looks_for_garbage(_number: int) -> tuple[int, int]:
    return gc.get_freeze_count(), gc.get_threshold()[0]


def test_workers_do_not_look_at_what_is_loaded_and_seldom_at_the_rest() -> None:
    with Workers(1) as workers:
        [(_, done)] = workers.run([Task(("looks",), _looks_for_garbage, (0,))])
    kept, collected_after = done.value
    assert kept > 50_000
    assert collected_after == COLLECTED_AFTER


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_workers_end_with_a_command_that_is_killed(tmp_path: Path, number: int) -> None:
    (tmp_path / "endless.py").write_text(ENDLESS)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(tmp_path / "endless.py")]
    run = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True, preexec_fn=hear_signals)
    assert run.stdout is not None
    with run.stdout:
        pids = {int(run.stdout.readline()) for _ in range(2)}
        run.send_signal(number)
        run.wait(timeout=300)
    until = time.monotonic() + 300
    while any(Path(f"/proc/{pid}").exists() for pid in pids):
        assert time.monotonic() < until, f"workers {pids} are still alive"
        time.sleep(0.05)
