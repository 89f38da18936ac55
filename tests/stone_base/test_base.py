"""A number agrees with its noun, releases are compared by their numbers, garbage is collected seldom."""

import gc
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stone_base.counts import counted
from stone_base.process_tuning import COMMAND_COLLECTS_AFTER
from stone_base.releases import is_older


@pytest.mark.parametrize(
    ("count", "words", "said"),
    [
        (0, ("sequence",), "0 sequences"), (1, ("sequence",), "1 sequence"), (12_345, ("frame",), "12,345 frames"),
        (1, ("entry", "entries"), "1 entry"), (2, ("entry", "entries"), "2 entries"),
    ],
)  # fmt: skip
def test_a_number_agrees_with_its_noun(count: int, words: tuple[str, ...], said: str) -> None:
    assert counted(count, *words) == said


NUMBERS = st.tuples(*[st.integers(0, 999_999)] * 3)


def spelled(numbers: tuple[int, ...]) -> str:
    return ".".join(map(str, numbers))


@given(NUMBERS, NUMBERS)
def test_the_older_release_is_that_of_the_smaller_numbers(one: tuple[int, ...], other: tuple[int, ...]) -> None:
    assert is_older(spelled(one), spelled(other)) == (one < other)


@pytest.mark.parametrize(
    ("release", "than", "is_it"),
    [("0.9.0", "0.10.0", True), ("0.9", "0.9.1", True), ("1.0.0", "1.0", False), ("0.9.0.dev3", "0.10.0", True)],
)
def test_a_release_is_read_as_packages_spell_it(release: str, than: str, is_it: bool) -> None:
    assert is_older(release, than) is is_it


@given(st.text(max_size=60).filter(lambda text: "." not in text) | st.sampled_from(["", "1" * 5000 + ".0", "٠.٠"]))
def test_what_is_no_release_is_not_older_than_any(text: str) -> None:
    assert not is_older(text, "999999.0.0")


ENDS = """
import gc
from stone_base.process_tuning import tune_command

class Cycle:
    def __init__(self):
        self.itself = self

    def __del__(self):
        print("found")

if {seldom}:
    tune_command()
Cycle()
if {asked}:
    gc.collect()
"""


def said(*, seldom: bool, asked: bool = False) -> str:
    """What the finder of a cycle says in a process that ends with it."""
    code = ENDS.format(seldom=seldom, asked=asked)
    return subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.strip()


@pytest.mark.parametrize(("seldom", "expected"), [(False, "found"), (True, "")])
def test_what_is_left_at_the_end_is_not_looked_at(seldom: bool, expected: str) -> None:
    assert said(seldom=seldom) == expected


def test_until_then_cycles_are_found_and_importing_a_module_does_it_too() -> None:
    assert said(seldom=True, asked=True) == "found"
    code = "import gc, services.runtime.processes.seldom_collected; print(gc.get_threshold()[0])"
    count = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert int(count) == COMMAND_COLLECTS_AFTER > gc.get_threshold()[0]
