"""A good dataset in both layouts, and copies of it to be changed."""

import json
from collections.abc import Callable
from pathlib import Path
from shutil import copytree
from typing import Any

import pytest

from testing.worlds.published_datasets import VERSION, SyntheticDataset, made_labels, write_annotated, write_published

GOOD = SyntheticDataset(
    labels=(made_labels(1), made_labels(2)), splits={"train": ["field-0000"], "val": ["field-0001"]}
)
Rows = list[dict[str, Any]]
Edit = Callable[[Path], object]


@pytest.fixture(scope="session")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes of three frames, a LiDAR, two cameras, a radar; nothing in it may be changed."""
    return write_published(tmp_path_factory.mktemp("published"), GOOD)


@pytest.fixture(scope="session")
def good_annotated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same in Occ3D's layout."""
    return write_annotated(tmp_path_factory.mktemp("annotated"), GOOD)


@pytest.fixture
def copied(good: Path, tmp_path: Path) -> Path:
    return copytree(good, tmp_path / "copied")


@pytest.fixture
def copied_annotated(good_annotated: Path, tmp_path: Path) -> Path:
    return copytree(good_annotated, tmp_path / "annotated")


def rewritten(folder: Path, table: str, change: Callable[[Rows], object]) -> None:
    """Other rows in a table."""
    path = folder / VERSION / f"{table}.json"
    rows = json.loads(path.read_text())
    change(rows)
    path.write_text(json.dumps(rows))


def reannotated(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Another annotations.json."""
    path = folder / "annotations.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
