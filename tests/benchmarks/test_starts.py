"""The benchmark of short commands counts what a command left behind, and keeps the best of its rounds.

**Conventions.** What measures waits for all children of its process, so it has a process of its own here too.
"""

import json
import subprocess
import sys

from benchmarks.starts import Start, best_of

MEASURE = """
import json, sys
from benchmarks.processes import adopt_orphans
from benchmarks.starts import measured
adopt_orphans()
start = measured([sys.executable, "-c", sys.argv[1]])
print(json.dumps([start.wall_s, start.cpu_s]))
"""
BUSY = "import time; end = time.process_time() + 0.3\nwhile time.process_time() < end: pass"


def run(program: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", MEASURE, program]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=120)


def test_the_processor_time_of_what_a_command_left_behind_is_counted() -> None:
    found = run(f"import subprocess, sys; subprocess.Popen([sys.executable, '-c', {BUSY!r}])")
    wall_s, cpu_s = json.loads(found.stdout)
    assert cpu_s >= 0.3, "the child that outlived its parent is in it"
    assert wall_s > 0


def test_a_command_that_fails_is_not_measured() -> None:
    found = run("raise SystemExit(3)")
    assert found.returncode != 0
    assert "exit status 3" in found.stderr


def test_the_best_of_the_rounds_is_shown() -> None:
    rounds = [{"a": Start(2.0, 1.0)}, {"a": Start(1.5, 1.2)}]
    assert best_of(rounds) == {"a": Start(1.5, 1.0)}
