"""A process that opens a run for each of its jobs reads the sequence once, and anew where the file is another."""

from dataclasses import replace
from pathlib import Path

from services.domain.sequences.run_files import CHECKED_FILE, SEQUENCE_FILE
from services.labeler.kernel_warmup import warmup_sequence
from services.labeler.sandboxed_run import RunOpening
from stone_recordings.sync.sequence_file import sequence_bytes


def write(path: Path, name: str) -> None:
    """As stages leave files: written beside, renamed into place."""
    staging = path.with_name("staging")
    staging.write_bytes(sequence_bytes(replace(warmup_sequence(), name=name)))
    staging.replace(path)


def test_a_sequence_is_read_once(tmp_path: Path) -> None:
    write(tmp_path / SEQUENCE_FILE, "one")
    opening = RunOpening(tmp_path, "local", {})
    assert opening.run().sequence is opening.run().sequence
    assert opening.run().sequence.name == "one"


def test_a_file_that_was_replaced_and_another_file_are_read_anew(tmp_path: Path) -> None:
    write(tmp_path / SEQUENCE_FILE, "one")
    write(tmp_path / CHECKED_FILE, "two")
    opening = RunOpening(tmp_path, "local", {})
    checked = replace(opening, sequence_file=CHECKED_FILE)
    assert [one.run().sequence.name for one in (opening, checked, opening)] == ["one", "two", "one"]
    write(tmp_path / SEQUENCE_FILE, "six")
    assert opening.run().sequence.name == "six"
