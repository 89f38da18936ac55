"""Workers do every task, pass errors on, and do not outlive who asked for them; a run that is opened for each of their
jobs is read once, and what its cameras see is laid out once."""

import gc
import os
import resource
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from services.domain.sequences.run_files import CHECKED_FILE, SEQUENCE_FILE
from services.labeler.errors import no_usable_frames
from services.labeler.frames import _sight_of
from services.labeler.kernel_warmup import warmup_sequence
from services.labeler.parameters import LabelParameters
from services.labeler.process_pool import Task, Workers
from services.labeler.run import LabelRun
from services.labeler.sandboxed_run import RunOpening
from stone.geometry.se3 import SE3
from stone.labels.sight_batches import SightBatch
from stone.labels.visibility import sight_lines
from stone.sensors.calibration import Calibration
from stone.sensors.sequence import Frames, Sequence
from stone_base.label_grid import PAPER
from stone_base.process_tuning import COMMAND_COLLECTS_AFTER, keep_freed_memory
from stone_recordings.sync.sequence_file import sequence_bytes
from testing.refusals import refused_as
from testing.signals import hear_signals
from tests.services.labeler.worlds import CALIBRATION, CAMERA, RayCast, World, sequence_of

ROOT = Path(__file__).resolve().parents[3]
ENDLESS = """
import os, time
from services.labeler.process_pool import Task, Workers
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
    raise no_usable_frames(Sequence(name, frames, (), Calibration("rig", SE3.identity()), "none"))


def test_every_task_is_done_and_says_what_it_came_to() -> None:
    with Workers(2) as workers:
        done = {task.key: result.value for task, result in workers.run([Task((n,), square, (n,)) for n in range(3)])}
    assert done == {(0,): 0, (1,): 1, (2,): 4}


def test_a_refusal_in_a_worker_reaches_the_caller_as_it_was() -> None:
    with Workers(1) as workers, refused_as("no_frames", match="run"):
        list(workers.run([Task(("refused",), refuse, ("run",))]))


@pytest.mark.whole
def test_a_failure_does_not_wait_for_the_other_tasks() -> None:
    begin = time.monotonic()
    tasks = [Task((seconds,), _refuse_or_sleep, (seconds,)) for seconds in (0.0, 600.0)]
    with refused_as("no_frames"), Workers(2) as workers:
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
    assert collected_after == COMMAND_COLLECTS_AFTER


def test_workers_and_children_that_score_load_nothing_of_the_database() -> None:
    """Catches alone a merge of modules that makes each worker a fifth larger."""
    modules = "services.labeler.kernel_warmup, services.eval.examination, services.eval.sandboxed_truth"
    code = f"import sys, {modules}; print({{'sqlalchemy', 'celery', 'opentelemetry'}} & set(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    assert loaded == "set()\n"


@pytest.mark.whole
def test_workers_end_with_a_command_that_is_killed(tmp_path: Path) -> None:
    (tmp_path / "endless.py").write_text(ENDLESS)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(tmp_path / "endless.py")]
    run = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True, preexec_fn=hear_signals)
    assert run.stdout is not None
    with run.stdout:
        pids = {int(run.stdout.readline()) for _ in range(2)}
        run.kill()
        run.wait(timeout=300)
    until = time.monotonic() + 300
    while any(Path(f"/proc/{pid}").exists() for pid in pids):
        assert time.monotonic() < until, f"workers {pids} are still alive"
        time.sleep(0.05)


def faults_of_a_task() -> int:
    import numpy as np

    for turn in range(20):
        if turn == 2:
            before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        [np.ones(2**20) for _ in range(4)]
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


@pytest.mark.skipif(sys.platform != "linux", reason="mallopt is glibc's")
def test_workers_keep_freed_memory() -> None:
    with Workers(1) as workers:
        [(_task, done)] = workers.run([Task(("a",), faults_of_a_task, ())])
    assert done.value < 100
    assert keep_freed_memory()


def write(path: Path, name: str) -> None:
    """As stages leave files: written beside, renamed into place."""
    staging = path.with_name("staging")
    staging.write_bytes(sequence_bytes(replace(warmup_sequence(), name=name)))
    staging.replace(path)


def test_a_sequence_is_read_once(tmp_path: Path) -> None:
    write(tmp_path / SEQUENCE_FILE, "one")
    opening = RunOpening(tmp_path, "local", {})
    assert opening.run().sequence is opening.run().sequence
    assert opening.run().sequence.name == "one"


def test_a_file_that_was_replaced_and_another_file_are_read_anew(tmp_path: Path) -> None:
    write(tmp_path / SEQUENCE_FILE, "one")
    write(tmp_path / CHECKED_FILE, "two")
    opening = RunOpening(tmp_path, "local", {})
    checked = replace(opening, sequence_file=CHECKED_FILE)
    assert [one.run().sequence.name for one in (opening, checked, opening)] == ["one", "two", "one"]
    write(tmp_path / SEQUENCE_FILE, "six")
    assert opening.run().sequence.name == "six"


WORLD = World()
BACKWARD = SE3.from_parts(np.array([0.0, 0, 0, 1.0]), np.zeros(3))


def run_in(scratch: Path, calibration: Calibration = CALIBRATION) -> LabelRun:
    sequence = replace(sequence_of(WORLD), calibration=calibration)
    return LabelRun(sequence, RayCast(WORLD), LabelParameters(), scratch)


def test_parts_of_a_run_share_it(tmp_path: Path) -> None:
    run = run_in(tmp_path)
    assert _sight_of(run) is _sight_of(run)


def test_another_run_in_the_same_folder_sees_what_its_own_cameras_see(tmp_path: Path) -> None:
    before = _sight_of(run_in(tmp_path))
    turned = replace(CAMERA, lidar_from_sensor=BACKWARD @ CAMERA.lidar_from_sensor)
    run = run_in(tmp_path, replace(CALIBRATION, mounts=(turned,)))
    nothing = np.zeros((1, *PAPER.shape[:2]), np.uint32)
    assert turned.intrinsics is not None
    alone = SightBatch([sight_lines(turned.intrinsics, CALIBRATION.ego_from_lidar @ turned.lidar_from_sensor)])
    assert (_sight_of(run).visible(nothing) == alone.visible(nothing)).all()
    assert (before.visible(nothing) != alone.visible(nothing)).any()


def test_two_threads_do_not_follow_lines_in_the_same_memory(tmp_path: Path) -> None:
    run = run_in(tmp_path)
    own = _sight_of(run)
    with ThreadPoolExecutor(1) as other:
        assert other.submit(_sight_of, run).result() is not own
