"""What fuzzing found stays found: each input that once broke a parser is read, or refused by code, on every run.

The cases are the inputs as libFuzzer left them, `cases/<target>/<what was wrong>`.
"""

from pathlib import Path

import pytest

from fuzz.limits import UncodedError, check
from fuzz.seeds import SEEDS
from fuzz.targets import TARGETS, limits_of
from stone.errors import StoneError

CASES = Path(__file__).with_name("cases")
FOUND = sorted(path for path in CASES.rglob("*") if path.is_file())
ROOT = Path(__file__).resolve().parents[2]


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


@pytest.mark.parametrize("error", [StoneError("bare"), WordyError("one")])
def test_a_refusal_that_no_program_understands_is_noticed(error: StoneError) -> None:
    def refuse(content: bytes) -> None:
        raise error

    with pytest.raises(UncodedError):
        check(refuse, b"")
