"""Freed memory is kept for the next arrays: they cost no page faults."""

import resource
import subprocess
import sys

import pytest

from services.labeler.freed_memory import keep_freed_memory
from services.labeler.workers import Task, Workers

MEASURED = """
import resource
import numpy as np
from services.labeler.freed_memory import keep_freed_memory
if {kept}:
    keep_freed_memory()
for turn in range(20):
    if turn == 2:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    [np.ones(2**20) for _ in range(4)]
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(*, kept: bool) -> int:
    """Of eighteen times four arrays of 8 MiB, given up together."""
    done = subprocess.run(
        [sys.executable, "-c", MEASURED.format(kept=kept)], check=True, capture_output=True, text=True
    )
    return int(done.stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="mallopt is glibc's")
def test_new_arrays_take_the_pages_of_those_given_up() -> None:
    assert faults(kept=True) < 100


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
