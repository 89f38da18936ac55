"""What another process has used is what it says of itself; of one that ended nothing is known."""

import os
import resource
import time
from pathlib import Path

import pytest

from services.runtime.telemetry.process_usage import ProcessUsage, held_bytes, usage_of

TICK_S = 0.01


def test_a_process_is_told_what_it_knows_of_itself() -> None:
    before_s = time.process_time()
    used = usage_of(os.getpid())
    assert before_s - 2 * TICK_S <= used.cpu_s <= time.process_time() + 2 * TICK_S
    assert used.held_bytes == pytest.approx(held_bytes(), rel=0.2)
    assert used.held_bytes <= used.peak_bytes
    assert used.peak_bytes == pytest.approx(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024, rel=0.2)


def test_of_a_process_that_ended_nothing_is_known(tmp_path: Path) -> None:
    assert usage_of(1, tmp_path) == ProcessUsage()
