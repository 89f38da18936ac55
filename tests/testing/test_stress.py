"""A test under stress: each run counts once, beside load that ends with it."""

import os
import subprocess
import sys
from pathlib import Path

import psutil

ROOT = Path(__file__).resolve().parents[2]
TESTS = """
import pytest
RUNS = []

@pytest.fixture
def world():
    RUNS.append(1)
    print("output of run", len(RUNS))
    return []

class Test:
    @pytest.mark.parametrize("n", [7])
    def test_sound(self, n, world):
        assert not world and not hasattr(self, "is_used")
        self.is_used = world.append(n)

    def test_every_third(self, world):
        assert len(RUNS) % 3
"""


def run(folder: Path, test: str) -> tuple[int, str]:
    """Ten runs of the test; the exit code and what was printed."""
    (folder / "pytest.ini").write_text("[pytest]\n")
    (folder / "test_a.py").write_text(TESTS)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    command = [sys.executable, "-m", "testing.stress", test, "--runs", "10"]
    ended = subprocess.run(command, cwd=folder, env=environment, check=False, capture_output=True, text=True)
    return ended.returncode, ended.stdout + ended.stderr


def test_runs_that_fail_are_counted_and_the_first_is_reported(tmp_path: Path) -> None:
    code, output = run(tmp_path, "test_a.py::Test::test_every_third")
    assert (code, output.splitlines()[-1]) == (1, "3 of 10 failed")
    assert output.count("output of run 3") == 1, "of the first failure only"
    assert "assert (3 % 3)" in output
    assert "output of run 6" not in output


def test_a_sound_test_passes_as_often_as_it_runs(tmp_path: Path) -> None:
    code, output = run(tmp_path, "test_a.py::Test::test_sound[7]")
    assert (code, output.splitlines()[-1]) == (0, "0 of 10 failed")
    assert "10 passed" in output


def test_a_test_that_does_not_exist_has_not_passed(tmp_path: Path) -> None:
    code, output = run(tmp_path, "test_a.py::test_other")
    assert code == 4
    assert "not found" in output


def test_the_load_ends_with_the_runs(tmp_path: Path) -> None:
    text = "import os\ndef test_a():\n    open('parent', 'w').write(str(os.getpid()))\n"
    text += "    import psutil\n    assert len(psutil.Process().children()) == 2 * os.cpu_count()\n"
    (tmp_path / "test_b.py").write_text(text)
    code, output = run(tmp_path, "test_b.py")
    assert code == 0, output
    parent = (tmp_path / "parent").read_text()
    assert not [process for process in psutil.process_iter(["cmdline"]) if parent in (process.info["cmdline"] or [])]
