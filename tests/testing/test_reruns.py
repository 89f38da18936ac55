"""`--rerun-failed-once`: a test that fails beside the load and passes alone ends green, and its name is printed last.

Catches alone a run that ends green although a test is broken, or red because of a race.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.whole

ROOT = Path(__file__).resolve().parents[2]
BESIDE = ["-p", "xdist.plugin", "-n2"]

FLAKY = """
from pathlib import Path

def fails_once(name):
    seen = Path(__file__).parent / f"{name}.seen"
    if not seen.exists():
        seen.touch()
        raise AssertionError(f"{name} fails beside the load")

"""


def flaky_tests(count: int) -> str:
    return FLAKY + "".join(f"def test_flaky_{n}():\n    fails_once('flaky {n}')\n\n" for n in range(count))


def run(folder: Path, *options: str, **files: str) -> tuple[int, list[str]]:
    """Write the test files and run them with the option; return the exit code and the lines that pytest printed."""
    (folder / "pytest.ini").write_text("[pytest]\n")
    for name, text in files.items():
        (folder / f"{name}.py").write_text(text)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    command = [sys.executable, "-m", "pytest", "-p", "testing.reruns", "--rerun-failed-once", *options]
    ended = subprocess.run(command, cwd=folder, env=environment, check=False, capture_output=True, text=True)
    return ended.returncode, ended.stdout.splitlines()


def test_tests_that_pass_the_second_time_end_green_and_are_named_last(tmp_path: Path) -> None:
    names = "@pytest.mark.parametrize('name', ['a b[::]', 'ü'])\ndef test_named(name):\n    fails_once(name[:1])\n"
    code, lines = run(tmp_path, *BESIDE, test_a="import pytest\n" + FLAKY + names, test_b=flaky_tests(1))
    tests = {"test_a.py::test_named[a b[::]]", "test_a.py::test_named[\\xfc]", "test_b.py::test_flaky_0"}
    assert code == 0, lines
    assert set(lines[-3:]) == {f"flaky: {test}" for test in tests}
    assert (tmp_path / "build" / "flaky-tests").read_text("utf-8").splitlines() == lines[-3:]
    assert "E           AssertionError: flaky 0 fails beside the load" in lines, "the first report is kept"


def test_a_test_that_fails_twice_ends_red_with_both_reports_and_the_flaky_one_is_named(tmp_path: Path) -> None:
    broken = "def test_broken():\n    assert 1 + 1 == 3\n"
    code, lines = run(tmp_path, test_a=flaky_tests(1), test_b=broken)
    assert code == 1, lines
    assert lines.count("E       assert (1 + 1) == 3") == 2
    assert lines[-2:] == ["failed again: test_b.py::test_broken", "flaky: test_a.py::test_flaky_0"]


def test_four_failed_tests_end_red_and_none_runs_again(tmp_path: Path) -> None:
    code, lines = run(tmp_path, *BESIDE, test_a=flaky_tests(4))
    assert code == 1, lines
    assert lines[-1] == "4 tests failed, more than 3: none runs again"


def test_each_failed_test_runs_again_in_a_process_of_its_own(tmp_path: Path) -> None:
    """What one of them leaves in its process, or a test that passed, cannot make another pass."""
    leaves = "LEFT = []\ndef test_leaves():\n    LEFT.append(1)\ndef test_needs():\n    assert not LEFT\n"
    code, lines = run(tmp_path, test_a=leaves)
    assert (code, lines[-1]) == (0, "flaky: test_a.py::test_needs")
    needs = "LEFT = []\ndef test_a():\n    LEFT.append(1)\n    assert len(LEFT) > 1\ndef test_b():\n    test_a()\n"
    code, lines = run(tmp_path, test_a=needs + "def test_c():\n    test_b()\n    raise OSError\n")
    assert (code, sum(line.startswith("failed again:") for line in lines)) == (1, 2)


@pytest.mark.parametrize(
    "second",
    ["import pytest\n    pytest.skip('too busy')", "import os\n    os._exit(0)"],
    ids=["skipped", "ended without a verdict"],
)
def test_only_a_test_that_passes_the_second_time_has_passed(tmp_path: Path, second: str) -> None:
    text = FLAKY + f"def test_twice():\n    fails_once('twice')\n    {second}\n"
    code, lines = run(tmp_path, test_a=text)
    assert (code, lines[-1]) == (1, "failed again: test_a.py::test_twice")


def test_a_failed_fixture_is_a_failed_test(tmp_path: Path) -> None:
    text = f"import pytest\n{FLAKY}@pytest.fixture\ndef world():\n    yield\n    fails_once('fixture')\n"
    code, lines = run(tmp_path, test_a=text + "def test_in_it(world):\n    pass\n")
    assert (code, lines[-1]) == (0, "flaky: test_a.py::test_in_it")


@pytest.mark.parametrize(
    ("options", "files"),
    [
        (["-x"], {}),
        ([*BESIDE, "--continue-on-collection-errors"], {"test_b": "raise OSError"}),
        (BESIDE, {"test_b": FLAKY + "def test_crash():\n    import os\n    os.kill(os.getpid(), 9)\n"}),
    ],
    ids=["-x", "collection", "crash"],
)
def test_what_is_no_race_stays_red_and_nothing_runs_again(
    tmp_path: Path, options: list[str], files: dict[str, str]
) -> None:
    code, lines = run(tmp_path, *options, test_a=flaky_tests(1), **files)
    assert code != 0
    assert not [line for line in lines if "flaky:" in line or "again" in line], lines


def test_without_the_option_nothing_runs_again(tmp_path: Path) -> None:
    (tmp_path / "test_a.py").write_text(flaky_tests(1))
    command = [sys.executable, "-m", "pytest", "-p", "testing.reruns"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    ended = subprocess.run(command, cwd=tmp_path, env=environment, check=False, capture_output=True, text=True)
    assert (ended.returncode, "flaky:" in ended.stdout) == (1, False)
