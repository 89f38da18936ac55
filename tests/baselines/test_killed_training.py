"""`stone model train` as processes: killed at any moment it ends as if it never was; of several only the first writes.

Catches alone what a kill leaves half written, two writers of one run, and shares of frames that overlap.
"""

import json
import os
import random
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

from baselines.checkpoint import CHECKPOINT, provenance_of
from baselines.run_folder import LOG, TENSORBOARD
from baselines.train import TrainingPlan
from testing.refusals import refused_as
from tests.baselines.small_training import is_same_run, logged, logged_steps, row_record, small_row, trained

ROOT = Path(__file__).resolve().parents[2]
KILLS, EPOCHS = 2, 2
STEPS = 4 * EPOCHS


def start(row: Path, meadow: Path, run: Path, *more: str) -> "subprocess.Popen[bytes]":
    command = [
        sys.executable,
        "-m",
        "stone_client.main",
        "model",
        "train",
        str(row),
        str(meadow),
        "-o",
        str(run),
        *more,
    ]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(command, cwd=ROOT, env=environment, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)


def steps_said(run: Path) -> int:
    return (run / LOG).read_bytes().count(b"\n") if (run / LOG).exists() else 0


def kill_at(process: "subprocess.Popen[bytes]", run: Path, step: int, delay_s: float) -> None:
    """So long after this step was logged, wherever the process is then."""
    while process.poll() is None and steps_said(run) < step:
        time.sleep(0.002)
    time.sleep(delay_s)
    process.send_signal(signal.SIGKILL)
    process.wait()


def kept_step(run: Path) -> int:
    return provenance_of(run / CHECKPOINT).position.step if (run / CHECKPOINT).exists() else 0


def test_a_run_that_is_killed_again_and_again_ends_as_one_that_never_was(meadow: Path, tmp_path: Path) -> None:
    """Each kill costs the steps since the last checkpoint, at most."""
    draws = random.Random(int(os.environ.get("KILL_SEED", "7")))
    (tmp_path / "row.yaml").write_text(json.dumps(row_record(epochs=EPOCHS)))
    run, whole = tmp_path / "run", tmp_path / "whole"
    trained(TrainingPlan(small_row(epochs=EPOCHS), (meadow,), whole, cache=tmp_path / "cache"))
    reached = 0
    for _ in range(KILLS):
        more = ("--resume",) if (run / "row.json").exists() else ()
        process = start(tmp_path / "row.yaml", meadow, run, *more)
        kill_at(process, run, min(reached + draws.randint(0, 3), STEPS), draws.uniform(0, 0.1))
        kept = kept_step(run)
        assert kept >= reached // 2 * 2
        said = [line["step"] for line in logged(run)] if steps_said(run) else []
        assert said == list(range(1, len(said) + 1))
        assert len(said) - 3 <= kept <= len(said)
        reached = kept
    more = ("--resume",) if (run / "row.json").exists() else ()
    assert start(tmp_path / "row.yaml", meadow, run, *more).wait(600) == 0
    assert is_same_run(run, whole)
    assert logged_steps(run) == logged_steps(whole)
    assert not list(run.glob(".*.partial"))


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def run_twice(meadow: Path, run: Path) -> list[str]:
    """Return the output of `stone model train` in each of two processes, as torchrun starts them."""
    (run.parent / "row.yaml").write_text(json.dumps(row_record(batch=1)))
    command = [sys.executable, "-m", "stone_client.main", "model", "train", str(run.parent / "row.yaml"), str(meadow)]
    command += ["-o", str(run), "--json"]
    port = str(free_port())
    started = []
    for rank in ("0", "1"):
        said = {"RANK": rank, "LOCAL_RANK": rank, "WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port}
        environment = {**os.environ, **said, "OMP_NUM_THREADS": "1", "GLOO_SOCKET_IFNAME": "lo"}
        started.append(
            subprocess.Popen(
                command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
            )
        )
    ended = [process.communicate(timeout=600) for process in started]
    assert [process.returncode for process in started] == [0, 0], ended
    return [stdout for stdout, _ in ended]


def test_two_processes_train_one_model_and_the_first_writes(meadow: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    said = [json.loads(stdout) for stdout in run_twice(meadow, run)]
    assert [one["steps"] for one in said] == [8, 8]  # nine frames by two processes, twice
    assert provenance_of(run / CHECKPOINT).processes == 2
    assert logged_steps(run) == list(range(1, 9))
    assert len(list((run / TENSORBOARD).iterdir())) == 1
    with refused_as("bad_run", match="2 then, 1 now"):
        trained(TrainingPlan(small_row(batch=1), (meadow,), run, resume=True))
