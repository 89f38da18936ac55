"""A process that loads much still finds cycles, seldom, and does not look for them when it ends."""

import gc
import subprocess
import sys

import pytest

from stone_base.garbage import COLLECTED_AFTER

ENDS = """
import gc
from stone_base.garbage import collect_seldom

class Cycle:
    def __init__(self):
        self.itself = self

    def __del__(self):
        print("found")

if {seldom}:
    collect_seldom()
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


def test_until_then_cycles_are_found() -> None:
    assert said(seldom=True, asked=True) == "found"


def test_importing_a_module_does_it_for_who_can_be_told_modules_only() -> None:
    code = "import gc, services.runtime.processes.seldom_collected; print(gc.get_threshold()[0])"
    count = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert int(count) == COLLECTED_AFTER > gc.get_threshold()[0]
