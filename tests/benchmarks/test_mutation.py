"""Mutants: drawn by a seed, found again where the code went, and judged by tests that pass without them."""

import ast
import json
import subprocess
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.import_graph import read_import_graph, source_files
from benchmarks.mutation.__main__ import killed_share
from benchmarks.mutation.concerned import ClosestTests
from benchmarks.mutation.judging import Judge, Limits, Verdict
from benchmarks.mutation.mutants import Mutant, Source, draw, locate, new_path, read_source
from benchmarks.mutation.operators import places_of

CODE = '''"""Sums."""

LIMIT = 3


def total(values: list[int], is_short: bool = False) -> int:
    """Every value, or the first of them."""
    if len(values) > LIMIT and is_short:
        return sum(values[:LIMIT])
    return sum(values) + 0 * len("é") + 0
'''
TEST = """from sums.total import total


def test_values_add_up() -> None:
    assert total([1, 2]) == 3
"""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    root = tmp_path / "tree"
    for name, text in (("sums/total.py", CODE), ("tests/sums/test_total.py", TEST), ("sums/__init__.py", "")):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text, "utf-8")
    return root


def sources_of(root: Path) -> dict[Path, Source]:
    return {path: read_source(path) for path in source_files(root)}


def every_mutant(root: Path) -> list[Mutant]:
    return draw(root, {"sums": (["sums"], 1000)}, seed=1)


def test_a_seed_draws_the_same_mutants_and_each_changes_the_text_of_one_place(tree: Path) -> None:
    mutants = every_mutant(tree)
    assert mutants == every_mutant(tree)
    for mutant in mutants:
        located = locate(mutant, tree, {}, sources_of(tree))
        assert located is not None
        assert located.text != CODE
        assert ast.dump(ast.parse(located.text)) != ast.dump(ast.parse(CODE))


def test_types_texts_and_docstrings_are_left_alone() -> None:
    tree = ast.parse('def f(a: "list[int]" = 1) -> "x":\n    """Says."""\n    raise ValueError(f"{a + 1}")\n')
    assert [change for place in places_of(tree) for change in place.changes] == [
        ("constant", "2"),
        ("constant", "(0)"),
        ("statement removed", "pass"),
    ]


def test_a_mutant_is_found_where_its_file_went_and_its_names_changed(tree: Path) -> None:
    mutants = every_mutant(tree)
    moved = tree.parent / "moved"
    text = CODE.replace("values", "numbers").replace("total", "plain_sum").replace("Every value", "All")
    (moved / "adding").mkdir(parents=True)
    (moved / "adding" / "plain_sum.py").write_text(text, "utf-8")
    known = {"sums/total.py": "adding/plain_sum.py"}
    for mutant in mutants:
        located = locate(mutant, moved, known, sources_of(moved))
        assert located is not None
        assert located.line == mutant.line
        by_shape = locate(mutant, moved, {}, sources_of(moved))
        assert by_shape == (None if mutant.function == "<module>" else located), "without a map by its shape"
        unlike = replace(mutant, original="other", shape="other", function_shape="other")
        assert locate(unlike, moved, known, sources_of(moved)) is None


def test_a_folder_moves_what_is_below_it() -> None:
    assert new_path("a/b/c.py", {"a": "z", "a/b": "y/x"}) == "y/x/c.py"
    assert new_path("a/b/c.py", {"a/b/c.py": "d.py"}) == "d.py"
    assert new_path("a/b/c.py", {}) == "a/b/c.py"


def test_the_nearest_test_comes_first(tree: Path) -> None:
    (tree / "tests" / "test_all.py").write_text("import tests.sums.test_total\n", "utf-8")
    (tree / "tests" / "test_none.py").write_text("", "utf-8")
    nearest = ClosestTests(tree, read_import_graph(tree))
    assert list(nearest.tests_of(tree / "sums" / "total.py", 9)) == ["tests/sums/test_total.py", "tests/test_all.py"]


@pytest.mark.whole
def test_mutants_are_killed_survive_or_are_lost_and_the_tree_stays_sound(tree: Path) -> None:
    """Catches alone a mutant that is judged by a tree with another mutant, or by a test that fails without one."""
    for command in (["git", "init", "-q"], ["git", "add", "."]):
        subprocess.run(command, cwd=tree, check=True)
    mutants = every_mutant(tree)
    noticed = next(
        one for one in mutants if one.operator == "return nothing" and one.original.startswith("return sum(values) ")
    )
    unnoticed = next(one for one in mutants if one.original == "3")
    gone = replace(noticed, file="gone.py", shape="other", function_shape="other")
    folder = tree.parent / "mutation"
    for _ in range(2):
        Judge(tree, folder, Limits(60.0, 2)).run([noticed, unnoticed, gone], {}, is_again=False)
    record = json.loads((folder / "verdicts.json").read_text("utf-8"))
    killed, survived, lost = (Verdict(**one) for one in record["verdicts"])
    assert (killed.result, killed.by) == ("killed", "tests/sums/test_total.py::test_values_add_up")
    assert (survived.result, survived.tests) == ("survived", ["tests/sums/test_total.py"])
    assert (lost.result, lost.tests) == ("lost", [])
    assert killed_share(Counter(one.result for one in (killed, survived, lost))) == 0.5
    assert (folder / "tree" / "sums" / "total.py").read_text("utf-8") == CODE
