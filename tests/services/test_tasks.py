"""What a worker's parent loads before it forks."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ALLOCATOR = "jemalloc_bg_thd"  # pyarrow's, which starts again in the children by itself
ASKED = """
import json, os, sys, threading
from services.runtime.celery_app import app
app.loader.import_default_modules()
import numpy
from services.ingest.stages import open_described
from services.runtime import sweep_sources
print(json.dumps({
    "tasks": sorted(name for name in app.tasks if name.endswith(".work")),
    "threads": [os.environ.get(name) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")],
    "has_kernels": "stone.screened" in sys.modules,
    "has_open3d": "open3d" in sys.modules,
    "running": [open(f"/proc/self/task/{task}/comm").read().strip() for task in os.listdir("/proc/self/task")],
    "reads_sweeps": sweep_sources._PROVIDED == [open_described],
}))
"""


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "MKL_NUM_THREADS")
    environment = {name: value for name, value in os.environ.items() if name not in names}
    environment |= {"PYTHONPATH": str(ROOT), "STONE_DATA_FOLDER": str(tmp_path_factory.mktemp("data"))}
    outcome = subprocess.run(
        [sys.executable, "-c", ASKED], env=environment, check=True, capture_output=True, text=True, timeout=120
    )
    record: dict[str, object] = json.loads(outcome.stdout)
    return record


def test_every_queue_has_its_bell(loaded: dict[str, object]) -> None:
    assert loaded["tasks"] == ["eval.work", "ingest.work", "labeler.work"]


def test_libraries_have_one_thread_and_the_kernels_are_there_before_the_fork(loaded: dict[str, object]) -> None:
    assert loaded["threads"] == ["1", "1", "1"]
    assert (loaded["has_kernels"], loaded["has_open3d"]) == (True, False), "only the solver octree needs 200 MB more"
    others = [name for name in loaded["running"] if not name.startswith("python")]  # type: ignore[attr-defined]
    assert set(others) <= {ALLOCATOR}, "a fork takes one thread with it; a pool would be missing in the children"


def test_the_labeler_can_read_recordings(loaded: dict[str, object]) -> None:
    assert loaded["reads_sweeps"]
