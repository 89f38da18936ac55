"""Kernels and their indices: docs/developers/kernels.md names each, and checks of indices find one that is wrong."""

import ast
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "developers" / "kernels.md"
ROW = re.compile(r"^\| (?:`([^`]+)`)? ?\| `(\w+)` \| (.*) \| ?(.*) ?\|$", re.MULTILINE)
OF_TESTS = ("tests", ".venv", "build", "web")


def compiled() -> Iterator[tuple[str, str]]:
    """Every njit function and every vector step of the tree by its module; those of tests are theirs."""
    for path in sorted(ROOT.rglob("*.py")):
        module = path.relative_to(ROOT)
        if module.parts[0] not in OF_TESTS and "numba" in (text := path.read_text("utf-8")):
            yield from ((module.as_posix(), name) for node in ast.walk(ast.parse(text)) for name in _names(node))


def _names(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.FunctionDef) and any("njit" in ast.unparse(one) for one in node.decorator_list):
        yield node.name
    if isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(node.value, ast.Call):
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        if ast.unparse(node.value.func) in {"njit", "intrinsic"}:
            yield from (ast.unparse(target) for target in targets)


def documented() -> Iterator[tuple[str, str]]:
    module = ""
    for named, kernel, _, _ in ROW.findall(PAGE.read_text("utf-8")):
        module = named or module
        yield module, kernel


@pytest.mark.whole
def test_every_kernel_is_on_the_page_and_nothing_else() -> None:
    found, told = Counter(compiled()), Counter(documented())
    assert found.total() > 100
    assert found - told == Counter(), "kernels that the page does not name"
    assert told - found == Counter(), "rows of what is no kernel"


def test_every_index_that_comes_from_data_has_its_reason() -> None:
    rows = ROW.findall(PAGE.read_text("utf-8"))
    assert [kernel for _, kernel, indices, why in rows if indices.strip() not in {"none", "nothing"} and not why] == []


PLANTED = """
import numpy as np
from numba import njit
from stone.kernels.column_words import drivable32, pack1, pack8, unroll8
from stone.kernels.lanes import looked_up, spread, transpose
from stone.labels.sight_batches import LANES, _half_open, _reach

@njit
def step(kind, a, b, c, at):
    if kind == 0:
        a[at] = 0
    elif kind == 1:
        spread(np.uint32(1), np.uint32(2), a, at)
    elif kind == 2:
        looked_up(a[:500], (0, 0, at), (0, 0, at), (0, 0, 0), 0)
    elif kind == 3:
        transpose(b, at, c, 0)
    elif kind == 4:
        transpose(b, 0, c, at)
    elif kind == 5:
        pack8(a, at, b, c, 0)
    elif kind == 6:
        pack1(a, 0, b, c, at)
    elif kind == 7:
        drivable32(b, b, c, at)
    elif kind == 8:
        unroll8(np.uint32(1), b, at, c, 0)
    elif kind == 9:
        _half_open(a, at)
    elif kind == 10:
        o, w = np.int64(0), np.uint8(1)
        _reach(a, (o, o, o, at, o), (w, w, w, w), np.uint32(1))

a, b, c = np.zeros(512, np.uint8), np.zeros(512, np.uint32), np.zeros(512, np.uint32)
for kind in range(11):
    step(kind, a, b, c, 0)
    for at in (512, -1 - 512, 1 << 40, np.iinfo(np.int64).min, *([-1, 511] if kind else [])):
        try:
            step(kind, a, b, c, at)
        except IndexError:
            continue
        if kind == 2 and at % 2**32 == 0:  # layers are counted in 32 bits: it is the first
            continue
        if (kind, at) not in {(6, 511), (8, -1)}:  # one word, which is there; what is read begins one later
            print("unnoticed", kind, at)
print("tried")
"""


@pytest.mark.whole
def test_an_index_out_of_range_is_noticed_where_indices_are_checked(tmp_path: Path) -> None:
    """In a process of its own: numba is told when it is loaded, and would take unchecked code from a cache."""
    checked = {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    environment = {**os.environ, **checked, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", PLANTED]
    said = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=300)
    assert (said.stdout, said.returncode) == ("tried\n", 0), said.stderr[-2000:]


@pytest.mark.skipif(os.environ.get("NUMBA_BOUNDSCHECK") != "1", reason="indices are checked by make test-kernels alone")
def test_indices_are_checked_in_this_run() -> None:
    import numpy as np

    from stone.labels.observed_voxels import _rehash

    few, many = np.zeros(2, np.int64), np.full(4, -1, np.int64)
    with pytest.raises(IndexError):
        _rehash(
            (few, np.zeros(1, np.uint64), few.astype(np.int32)), (many, np.zeros(4, np.uint64), many.astype(np.int32))
        )
