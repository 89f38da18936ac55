"""What fuzzing found stays found: each input that once broke a parser is read, or refused by code, on every run.

The cases are the inputs as libFuzzer left them, `cases/<target>/<what was wrong>`.
"""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from fuzz.limits import UncodedError, check
from fuzz.seeds import SEEDS
from fuzz.targets import TARGETS, limits_of
from stone.errors import StoneError

CASES = Path(__file__).with_name("cases")
FOUND = sorted(path for path in CASES.rglob("*") if path.is_file())
ROOT = Path(__file__).resolve().parents[2]
GROWING = """
import numpy as np
from fuzz.limits import GROWTH_LIMIT_BYTES, GrowthError, check
np.ones(4 * GROWTH_LIMIT_BYTES, np.uint8)
try:
    check(lambda _: np.ones(2 * GROWTH_LIMIT_BYTES, np.uint8), b"x")
except GrowthError as error:
    print(error)
"""


class WordyError(StoneError):
    code = "wordy"

    def __str__(self) -> str:
        return "two\nlines"


@pytest.mark.parametrize("path", FOUND, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_an_input_that_once_broke_a_parser_does_not(path: Path) -> None:
    check(TARGETS[path.parent.name], path.read_bytes(), limits_of(path.parent.name))


@pytest.mark.parametrize(
    "target", [pytest.param(name, marks=pytest.mark.release if name == "labels" else ()) for name in TARGETS]
)
def test_every_seed_is_read_or_refused_by_code(target: str) -> None:
    seeds = dict(SEEDS[target]())
    assert seeds
    for content in seeds.values():
        check(TARGETS[target], content, limits_of(target))


def test_growth_is_noticed_after_whatever_the_process_once_held() -> None:
    """In a process of its own: in a worker of the suite, what tests before it left is freed at any moment."""
    command = [sys.executable, "-c", GROWING]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=True)
    assert re.fullmatch(r"12[78] MiB for an input of 1 bytes, the limit is 64 MiB\n", done.stdout)


@pytest.mark.parametrize("error", [StoneError("bare"), WordyError("one")])
def test_a_refusal_that_no_program_understands_is_noticed(error: StoneError) -> None:
    def refuse(content: bytes) -> None:
        raise error

    with pytest.raises(UncodedError):
        check(refuse, b"")
