"""The script of the SDK's page: short, of public names only, typed; tables with and without pandas."""

import ast
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import stone_client
from docsite.pages import made_pages
from stone_client import sdk
from stone_client.sdk import Table
from tests.e2e.pasting import blocks

ROOT = Path(__file__).resolve().parents[2]
MOST_LINES = 20


def script() -> str:
    (text,) = (block for kind, block in blocks("sdk.md") if kind == "python")
    return text


def test_the_script_imports_nothing_of_ours_but_the_sdk() -> None:
    tree = ast.parse(script())
    imported = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    assert [(node.module, [name.name for name in node.names]) for node in imported] == [("stone_client", ["Stone"])]
    assert len(script().splitlines()) <= MOST_LINES


def test_the_script_is_typed(tmp_path: Path) -> None:
    """By what the package declares: a user's mypy reads types of a package that says it has some."""
    assert (Path(stone_client.__file__).parent / "py.typed").exists()
    (tmp_path / "label.py").write_text(
        script() + "\nreveal_type(semantics)\nreveal_type(stone.label_sets(name)[0].id)\n"
    )
    command = [sys.executable, "-m", "mypy", "--strict", "--follow-imports", "silent", str(tmp_path / "label.py")]
    checked = subprocess.run(command, check=False, capture_output=True, text=True, cwd=ROOT)
    assert checked.returncode == 0, checked.stdout
    revealed = [line.partition("Revealed type is ")[2] for line in checked.stdout.splitlines() if "Revealed" in line]
    assert "unsignedinteger" in revealed[0]
    assert revealed[1] == '"str"'


def test_every_class_of_the_sdk_is_on_the_reference_page() -> None:
    page = made_pages()["reference/sdk.md"]
    assert [name for name in sdk.__all__ if name[0].isupper() and f"\n## {name}\n" not in page] == []
    assert "### Stone.upload\n" in page
    assert "object at 0x" not in page


@dataclass(frozen=True)
class Score:
    method: str
    ratios: dict[str, float | None]
    record: dict[str, Any] = field(default_factory=dict, repr=False)


SCORES = Table(Score, [Score("<b>A</b>", {"miou": 0.25, "iou_t": None}), Score("B", {"miou": 0.5, "iou_t": 0.125})])


def test_a_table_is_a_sequence_that_shows_its_fields() -> None:
    assert (len(SCORES), SCORES[1].method, [one.method for one in SCORES[:1]]) == (2, "B", ["<b>A</b>"])
    assert SCORES.rows()[0] == {"method": "<b>A</b>", "miou": 0.25, "iou_t": None}
    shown = SCORES._repr_html_()
    assert "<td>&lt;b&gt;A&lt;/b&gt;</td><td>0.2500</td><td></td>" in shown
    assert repr(SCORES).splitlines()[0] == "<2 × Score>"


def test_a_table_becomes_a_data_frame_where_pandas_is(monkeypatch: pytest.MonkeyPatch) -> None:
    pandas = ModuleType("pandas")
    pandas.DataFrame = lambda rows, columns: (rows, columns)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "pandas", pandas)
    assert SCORES.to_pandas() == (SCORES.rows(), None)
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ModuleNotFoundError):
        SCORES.to_pandas()
