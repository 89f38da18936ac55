"""Two supervisors never share a data folder, and the second learns who holds it."""

import os
import stat
from pathlib import Path

import pytest

from services.runtime.embedded.errors import AlreadyServingError
from services.runtime.embedded.folder_lock import LOCK, hold_folder


def test_a_second_server_is_told_the_process_and_the_url(tmp_path: Path) -> None:
    with hold_folder(tmp_path / "the data") as lock:
        lock.say("http://127.0.0.1:8080")
        with (
            pytest.raises(AlreadyServingError, match=rf"process {os.getpid()} serves it at http://127.0.0.1:8080"),
            hold_folder(tmp_path / "the data"),
        ):
            pass


def test_one_that_is_still_starting_is_named_too(tmp_path: Path) -> None:
    with (
        hold_folder(tmp_path),
        pytest.raises(AlreadyServingError, match=rf"process {os.getpid()} is starting"),
        hold_folder(tmp_path),
    ):
        pass


def test_a_lock_that_nobody_holds_any_more_is_taken(tmp_path: Path) -> None:
    (tmp_path / LOCK).write_text('{"pid": 1, "url": "http://gone"}')
    with hold_folder(tmp_path):
        pass
    with hold_folder(tmp_path):
        pass


def test_a_lock_file_half_written_is_no_reason_to_fail_differently(tmp_path: Path) -> None:
    with hold_folder(tmp_path):
        (tmp_path / LOCK).write_text("{")
        with pytest.raises(AlreadyServingError, match="is starting"), hold_folder(tmp_path):
            pass


def test_a_new_data_folder_is_its_owners_only(tmp_path: Path) -> None:
    with hold_folder(tmp_path / "data"):
        assert stat.S_IMODE((tmp_path / "data").stat().st_mode) == 0o700
