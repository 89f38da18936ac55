"""What a worker's parent loads before it forks."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from services.runtime.processes.worker import arguments
from testing.refusals import refused_as

ROOT = Path(__file__).resolve().parents[2]
ALLOCATOR = "jemalloc_bg_thd"  # pyarrow's, which starts again in the children by itself
ASKED = """
import json, os, sys, threading
from services.runtime.processes.worker import app, arguments
modules = arguments(sys.argv[1:], 1)
for module in modules[modules.index("--include") + 1].split(","):
    app.loader.import_task_module(module)
print(json.dumps({
    "tasks": sorted(name for name in app.tasks if name.endswith(".work")),
    "threads": [os.environ.get(name) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")],
    "has_kernels": "stone.surface.screened_poisson" in sys.modules,
    "has_open3d": "open3d" in sys.modules,
    "running": [open(f"/proc/self/task/{task}/comm").read().strip() for task in os.listdir("/proc/self/task")],
    "reads_recordings": "stone_recordings.sync.sweeps" in sys.modules,
    "services": sorted({name.split(".")[1] for name in sys.modules if name.startswith("services.")}),
}))
"""


def loaded_for(queues: tuple[str, ...], data: Path) -> dict[str, object]:
    """What a worker of these queues has, when it would fork."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "MKL_NUM_THREADS")
    environment = {name: value for name, value in os.environ.items() if name not in names}
    environment |= {"PYTHONPATH": str(ROOT), "STONE_DATA_FOLDER": str(data)}
    command = [sys.executable, "-c", ASKED, *queues]
    outcome = subprocess.run(command, env=environment, check=True, capture_output=True, text=True, timeout=300)
    record: dict[str, object] = json.loads(outcome.stdout)
    return record


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    return loaded_for(("ingest", "labeler", "eval"), tmp_path_factory.mktemp("data"))


def test_every_queue_has_its_bell(loaded: dict[str, object]) -> None:
    assert loaded["tasks"] == ["eval.work", "ingest.work", "labeler.work"]


def test_libraries_have_one_thread_and_the_kernels_are_there_before_the_fork(loaded: dict[str, object]) -> None:
    assert loaded["threads"] == ["1", "1", "1"]
    assert (loaded["has_kernels"], loaded["has_open3d"]) == (True, False), "only the solver octree needs 200 MB more"
    others = [name for name in loaded["running"] if not name.startswith("python")]  # type: ignore[attr-defined]
    assert set(others) <= {ALLOCATOR}, "a fork takes one thread with it; a pool would be missing in the children"


@pytest.mark.whole
@pytest.mark.parametrize(
    ("queue", "services"),
    [("labeler", ["domain", "labeler"]), ("eval", ["domain", "eval"])],
)
def test_a_worker_of_one_queue_loads_no_other_service_than_what_it_imports(
    tmp_path: Path, queue: str, services: list[str]
) -> None:
    loaded = loaded_for((queue,), tmp_path)
    assert loaded["services"] == sorted([*services, "runtime"])
    assert loaded["tasks"] == [f"{queue}.work"]
    assert loaded["reads_recordings"] == ("labeler" in services), "what reads recordings is there before the fork"


@pytest.mark.parametrize("queues", [(), ("ingest", "labels")])
def test_a_worker_of_no_queue_or_of_an_unknown_one_is_refused(queues: tuple[str, ...]) -> None:
    with refused_as("unknown_queue"):
        arguments(queues, 1)
