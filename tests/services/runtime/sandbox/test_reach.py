"""On any kernel, a child that is taken over can do only the actions that the documentation lists for its kind."""

from pathlib import Path

import pytest

from benchmarks.sandbox_reach import ATTEMPTS, KERNELS, NO, YES, reach
from services.runtime.sandbox import fences, seccomp
from services.runtime.sandbox.seccomp import KINDS

PAGE = Path(__file__).parents[4] / "docs" / "security" / "sandbox.md"
THIS, WITHOUT = "this", "no Landlock"
ENDS = (THIS, WITHOUT)  # of the kernels; those between them are tried before a release
pytestmark = [
    pytest.mark.whole,
    pytest.mark.skipif(not seccomp.is_known(), reason="this kernel or its container takes no seccomp filter"),
]


def documented() -> dict[str, list[str]]:
    """Return the cells of the page's table by attempt: each kind with Landlock, then each kind without it."""
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in PAGE.read_text().splitlines() if "|" in line]
    return {name: cells for name, *cells in rows if name in ATTEMPTS}


def test_the_page_has_a_row_of_every_attempt() -> None:
    assert list(documented()) == list(ATTEMPTS)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "kernel", [pytest.param(kernel, marks=() if kernel in ENDS else pytest.mark.release) for kernel in KERNELS]
)
def test_a_child_reaches_what_the_page_says_and_nothing_else(kind: str, kernel: str) -> None:
    if kernel != WITHOUT and fences.version() == 0:
        pytest.skip("this kernel has no Landlock")
    column = KINDS.index(kind) + len(KINDS) * (kernel == WITHOUT)
    found = {name: YES if reach(kind, name, kernel) == YES else NO for name in ATTEMPTS}
    assert found == {name: cells[column] for name, cells in documented().items()}


def test_what_is_refused_would_go_through_without_fences() -> None:
    """So the table can fail: a child without fences succeeds in every attempt that this kernel supports."""
    refused = {name for name in ATTEMPTS if reach("links", name, is_fenced=False) != YES}
    assert refused <= {"call what is newer than the list", "set an attribute elsewhere", "set one by the newer call"}
