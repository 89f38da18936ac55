"""The measures of a source tree, on a small tree of which every figure is known."""

from pathlib import Path

import pytest

from benchmarks.import_graph import cycles, hops, read_import_graph
from benchmarks.structure import (
    Tree,
    hops_to_kernels,
    hops_to_sql,
    public_names,
    read_tree,
    repeated_classes,
    rows,
    small_with_one_importer,
    width,
)

FILES = {
    "api/routes/__init__.py": "",
    "api/routes/sequences.py": "from core import rows\n",
    "api/routes/health.py": "ROUTE = 1\n",
    "stone_client/commands/label.py": "from core.pipeline import run\n",
    "core/__init__.py": "",
    "core/pipeline.py": "import core.kernels\ndef run():\n    import core.rows\nclass Row: ...\n",
    "core/kernels.py": "from numba import njit\n@njit\ndef _kernel(): ...\n",
    "core/rows.py": "from typing import TYPE_CHECKING\nfrom sqlalchemy import select\nfrom core import pipeline\n"
    "if TYPE_CHECKING:\n    import core.kernels\nclass Row: ...\n",
    "tests/test_core.py": "import core.kernels\n",
    "web/modules/main.ts": "export {};\n",
    "web/node_modules/other/other.ts": "export {};\n",
}


@pytest.fixture
def tree(tmp_path: Path) -> Tree:
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, "utf-8")
    return read_tree(tmp_path)


def test_an_import_in_a_function_makes_a_cycle_and_one_for_types_does_not(tree: Tree) -> None:
    graph = read_import_graph(tree.root)
    assert graph.imports["core.rows"] == {"core.pipeline"}
    assert cycles(graph.imports) == [["core.pipeline", "core.rows"]]
    assert graph.importers["core.kernels"] == {"core.pipeline", "tests.test_core"}


def test_hops_are_imports_on_the_shortest_way(tree: Tree) -> None:
    assert hops(tree.graph.imports, "api.routes.sequences") == {
        "api.routes.sequences": 0,
        "core.rows": 1,
        "core.pipeline": 2,
        "core.kernels": 3,
    }
    assert str(hops_to_sql(tree)) == "1.0 (1–1, 1 ways)", "a route without SQL has no way to it"
    assert str(hops_to_kernels(tree)) == "2.0 (2–2, 1 ways)"


def test_tests_and_what_others_wrote_are_counted_apart(tree: Tree) -> None:
    assert (width(tree.code).files, width(tree.tests).files, width(tree.pages).files) == (8, 1, 1)
    assert width(tree.code).siblings == 3.5
    assert width(tree.code).wide == 0


def test_names_are_counted_by_what_others_may_import(tree: Tree) -> None:
    assert public_names(tree) == 4
    assert repeated_classes(tree) == {"Row": ["core/pipeline.py", "core/rows.py"]}


def test_a_small_module_with_one_importer_is_named(tree: Tree) -> None:
    assert small_with_one_importer(tree) == ["core.kernels"]


def test_every_tree_has_the_same_rows(tree: Tree, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    assert [name for name, _ in rows(tree)] == [name for name, _ in rows(read_tree(tmp_path / "empty"))]
