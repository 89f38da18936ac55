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
    "traces": [name for name in sys.modules if "otlp" in name or name == "opentelemetry.sdk.trace"],
    "services": sorted({name.split(".")[1] for name in sys.modules if name.startswith("services.")}),
}))
"""


def loaded_for(queues: tuple[str, ...], data: Path) -> dict[str, object]:
    """What a worker of these queues has, when it would fork."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "MKL_NUM_THREADS", "OTEL_")
    environment = {name: value for name, value in os.environ.items() if not name.startswith(names)}
    environment |= {"PYTHONPATH": str(ROOT), "STONE_DATA_FOLDER": str(data)}
    command = [sys.executable, "-c", ASKED, *queues]
    outcome = subprocess.run(command, env=environment, check=True, capture_output=True, text=True, timeout=300)
    record: dict[str, object] = json.loads(outcome.stdout)
    return record


def test_every_queue_has_its_bell_and_what_jobs_need_is_there_before_the_fork(tmp_path: Path) -> None:
    loaded = loaded_for(("ingest", "labeler", "eval"), tmp_path)
    assert loaded["tasks"] == ["eval.work", "ingest.work", "labeler.work"]
    assert loaded["reads_recordings"]
    assert loaded["threads"] == ["1", "1", "1"]
    assert loaded["traces"] == [], "nobody switched it on"
    assert (loaded["has_kernels"], loaded["has_open3d"]) == (True, False), "only the solver octree needs 200 MB more"
    others = [name for name in loaded["running"] if not name.startswith("python")]  # type: ignore[attr-defined]
    assert set(others) <= {ALLOCATOR}, "a fork takes one thread with it; a pool would be missing in the children"


@pytest.mark.whole
def test_a_worker_of_one_queue_loads_no_other_service_than_what_it_imports(tmp_path: Path) -> None:
    loaded = loaded_for(("eval",), tmp_path)
    assert loaded["services"] == ["domain", "eval", "runtime"]
    assert loaded["tasks"] == ["eval.work"]
    assert not loaded["reads_recordings"]


@pytest.mark.parametrize("queues", [(), ("ingest", "labels")])
def test_a_worker_of_no_queue_or_of_an_unknown_one_is_refused(queues: tuple[str, ...]) -> None:
    with refused_as("unknown_queue"):
        arguments(queues, 1)
