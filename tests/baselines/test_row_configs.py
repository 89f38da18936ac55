"""Configurations of rows: all that are shipped can be read, and one that says something impossible is refused."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from baselines.errors import BadRowError
from baselines.row_config import known_rows, read_row, row_of
from baselines.run_folder import differences, read_run_row, say_row
from tests.baselines.small_training import row_record, small_row

TABLE_TWO = ("c-conet", "c-openocc", "l-conet", "l-openocc", "m-conet", "m-openocc", "occformer", "occfusion-cl",
             "occfusion-cr", "tpvformer")  # fmt: skip


def test_all_rows_of_the_table_are_shipped() -> None:
    assert set(TABLE_TWO) <= set(known_rows())


@pytest.mark.parametrize("name", known_rows())
def test_a_shipped_row_is_read_and_survives_its_run(name: str, tmp_path: Path) -> None:
    row = read_row(name)
    assert row.name == name
    say_row(tmp_path, row)
    assert read_run_row(tmp_path) == row


def test_changes_of_training_are_taken_and_nothing_is_changed_by_none() -> None:
    row = read_row("l-openocc", {"epochs": 3, "seed": None})
    assert row.training.epochs == 3
    assert row.training.seed == read_row("l-openocc").training.seed
    assert differences(row, read_row("l-openocc")).startswith("training.epochs 3, not ")


def test_a_file_of_ones_own_is_a_row(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(json.dumps(row_record()))
    assert read_row(str(path)) == small_row()


def changed(*path: str, to: Any) -> Callable[[dict[str, Any]], None]:
    def change(said: dict[str, Any]) -> None:
        for key in path[:-1]:
            said = said[key]
        said[path[-1]] = to

    return change


LIES: dict[str, tuple[Callable[[dict[str, Any]], None], str]] = {
    "an unknown key": (changed("epoch", to=3), "epoch is not a field"),
    "a misspelt key of training": (changed("training", "learning_rat", to=1), r"training\.learning_rat is not a field"),
    "a misspelt key of the model": (changed("model", "lattice", "shap", to=1), r"model\.lattice\.shap is not a field"),
    "another modality": (changed("inputs", "modality", to="C"), "inputs are of C, the model of L"),
    "a modality that is none": (changed("inputs", "modality", to="X"), "inputs.modality: .* found 'X'"),
    "pictures of another size": (lambda said: said.update(
        inputs={"modality": "C", "image_size_px": [32, 64]}, model={"architecture": "openocc", "modality": "C"}
    ), r"pictures of \(32, 64\) are given, the model is made for \(896, 1600\)"),
    "an architecture that is none": (changed("model", "architecture", to="resnet"), "model"),
    "a text for a number": (changed("training", "epochs", to="many"), r"training\.epochs: .* found 'many'"),
    "a precision that is none": (changed("training", "precision", to="float16"), r"training\.precision"),
    "no method": (lambda said: said.pop("method"), "method"),
}  # fmt: skip


@pytest.mark.parametrize("lie", LIES)
def test_what_says_something_impossible_is_refused(lie: str) -> None:
    said = json.loads(json.dumps(row_record()))
    change, why = LIES[lie]
    change(said)
    with pytest.raises(BadRowError, match=why) as refused:
        row_of("mine", said)
    assert "\n" not in str(refused.value)
    assert "Value error" not in str(refused.value)


@pytest.mark.parametrize(
    ("key", "value"),
    [("epochs", 0), ("batch", 0), ("accumulate", -1), ("stride", 0), ("checkpoint_steps", 0), ("learning_rate", -1.0)],
)
def test_counts_below_one_are_refused(key: str, value: float) -> None:
    with pytest.raises(BadRowError, match=key):
        small_row(**{key: value})


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "found 'None'"),
        (b"- a\n- b\n", "found"),
        (b"a: [", "it is not YAML"),
        (b"\xff\xfe\x00", "it is not YAML"),
        (b"a: !!python/object:os.system x\n", "it is not YAML"),
        (b"# " + b"x" * 70_000, "larger than 65536 bytes"),
    ],
)
def test_a_file_that_is_no_row_is_refused(tmp_path: Path, content: bytes, why: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_bytes(content)
    with pytest.raises(BadRowError, match=why):
        read_row(str(path))


def test_a_row_that_is_not_there_is_refused_with_those_that_are() -> None:
    with pytest.raises(BadRowError):
        read_row("l-opnocc")
