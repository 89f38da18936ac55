"""The name of a sequence by the file of its recording: whatever a file is called, labels can be made of it."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stone.sensors.sequence import NAME as OF_SEQUENCES
from stone_base.names import NAME
from stone_files.recording_name import sequence_name


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("run_2024-05-01.mcap", "run_2024-05-01"),
        ("Fahrt Nr. 3 – Wald (müde).mcap", "Fahrt-Nr.-3-Wald-mude"),
        ("my run (1).db3", "my-run-1"),
        ("_hidden.bag", "hidden"),
        ("-x.mcap", "x"),
        ("山道.mcap", "recording-8ef50c20"),
    ],
)
def test_a_file_gives_its_nearest_name(file: str, name: str) -> None:
    assert sequence_name(Path("/data") / file) == name


@given(st.text(min_size=1, max_size=300).filter(lambda text: "/" not in text and "\0" not in text))
def test_any_file_has_a_name_and_a_name_stays(text: str) -> None:
    name = sequence_name(Path("/data") / f"{text}.mcap")
    assert NAME.fullmatch(name)
    assert OF_SEQUENCES.pattern == NAME.pattern
    assert sequence_name(Path("/data") / f"{name}.mcap") == name


def test_the_folder_in_which_one_stands_has_its_own_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "drive_7").mkdir()
    monkeypatch.chdir(tmp_path / "drive_7")
    assert sequence_name(Path()) == "drive_7"
