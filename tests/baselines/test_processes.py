"""Training by several processes under torchrun: they train one model, and only the first writes.

Catches alone two writers of one run, and shares of frames that overlap.
"""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from baselines.checkpoint import CHECKPOINT, provenance_of
from baselines.errors import BadRunError
from baselines.run_log import TENSORBOARD
from baselines.train import TrainingPlan
from tests.baselines.small_training import logged_steps, row_record, small_row, trained

ROOT = Path(__file__).resolve().parents[2]


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def run_twice(meadow: Path, run: Path, *more: str) -> list[str]:
    """What `stone train` says in each of two processes, as torchrun starts them."""
    (run.parent / "row.yaml").write_text(json.dumps(row_record(batch=1)))
    command = [sys.executable, "-m", "stone_client.main", "train", str(run.parent / "row.yaml"), str(meadow)]
    command += ["-o", str(run), "--json", *more]
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
    run_twice(meadow, run, "--resume")
    assert logged_steps(run) == list(range(1, 9))
    with pytest.raises(BadRunError, match="its number of processes has changed: 2 then, 1 now"):
        trained(TrainingPlan(small_row(batch=1), (meadow,), run, resume=True))
