"""Common mistakes of tables are named as what they are, once per table with the number of rows, with what mends them.

Catches alone a refusal that asks for another mistake than the value shows.
"""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from shutil import copytree, make_archive
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest

from stone_base.label_grid import PAPER
from stone_datasets.reading import check_dataset
from testing.worlds.published_datasets import FIRST_US, VERSION
from tests.stone_datasets.conftest import GOOD, Rows, reannotated, rewritten
from tests.stone_datasets.malformed import row, table

STAMPED = ("sample", "ego_pose", "sample_data")
ROWS = {"sample": 6, "ego_pose": 24, "sample_data": 24}


def stamped(folder: Path, change: Callable[[int], Any], tables: tuple[str, ...] = STAMPED) -> None:
    """Other stamps in the rows of tables, and no stamps in the names of files."""
    for name in tables:
        rewritten(folder, name, lambda rows: [one.update(timestamp=change(one["timestamp"])) for one in rows])

    def renamed(rows: Rows) -> None:
        for number, one in enumerate(rows):
            head, _, ending = one["filename"].rpartition("__")
            name = f"{head}__{number}.{ending.partition('.')[2]}"
            (folder / one["filename"]).rename(folder / name)
            one["filename"] = name

    rewritten(folder, "sample_data", renamed)


UNITS: dict[str, tuple[Callable[[int], Any], str, str]] = {
    "seconds as floats": (lambda us: us / 1e6, "DST-016", "seconds as a float: multiply by 1,000,000"),
    "milliseconds as floats": (lambda us: us / 1e3, "DST-016", "milliseconds as a float: multiply by 1,000"),
    "microseconds as floats": (float, "DST-016", "microseconds as a float: write int(round(timestamp))"),
    "nanoseconds as floats": (lambda us: us * 1e3, "DST-016", "nanoseconds as a float: divide by 1,000"),
    "simulated seconds as floats": (lambda us: (us - FIRST_US) / 1e6, "DST-016", "seconds as a float"),
    "whole seconds": (
        lambda us: us // 10**6,
        "DST-028",
        "seconds instead of integer microseconds: multiply by 1,000,000",
    ),
    "milliseconds": (
        lambda us: us // 1000,
        "DST-028",
        "milliseconds instead of integer microseconds: multiply by 1,000",
    ),
    "nanoseconds": (lambda us: us * 1000, "DST-028", "nanoseconds instead of integer microseconds: divide by 1,000"),
    "simulated milliseconds": (lambda us: (us - FIRST_US) // 1000, "DST-028", "milliseconds instead"),
    "simulated nanoseconds": (lambda us: (us - FIRST_US) * 1000, "DST-028", "nanoseconds instead"),
    "milliseconds since boot": (lambda us: (us - FIRST_US) // 1000 + 668_000, "DST-028", "milliseconds instead"),
    "text of another kind": (lambda us: f"{us / 1e6}", "DST-016", "the number is written as text"),
    "no stamps": (lambda _us: None, "DST-016", "null"),
}


@pytest.mark.parametrize("unit", UNITS)
def test_stamps_of_another_unit_are_named_once_a_table_with_what_makes_microseconds(unit: str, copied: Path) -> None:
    change, code, cause = UNITS[unit]
    stamped(copied, change)
    faults = check_dataset(copied).faults
    assert {fault.code for fault in faults.found} == {code}
    assert {Path(fault.place.file).stem for fault in faults.found} >= {"sample"}
    for fault in faults.found:
        count = ROWS[Path(fault.place.file).stem]
        assert fault.rows == count
        assert f"; {count - 1} more rows of this file have the same fault" in str(fault)
        assert fault.place.row == 1
    assert cause in str(faults.found[0])
    assert faults.left_out == 0


UNDATED = {
    "simulated time": lambda us: us - FIRST_US,
    "simulated time from 0.4 s": lambda us: us - FIRST_US + 400_000,
    "time since boot": lambda us: us - FIRST_US + 668_000_000,
    "before 1970": lambda us: us - FIRST_US - 10**9,
    "beyond 2100": lambda us: us + 4 * 10**15,
}


@pytest.mark.parametrize("clock", UNDATED)
def test_microseconds_of_a_clock_that_was_not_set_are_read(clock: str, copied: Path) -> None:
    stamped(copied, UNDATED[clock])
    check = check_dataset(copied)
    assert [str(fault) for fault in check.faults.found] == []
    assert check.contents is not None
    assert [one["is_dated"] for one in check.contents.as_record()["sequences"]] == [False, False]


def test_rows_of_another_clock_than_the_frames_are_refused(copied: Path) -> None:
    stamped(copied, lambda us: us - FIRST_US, ("sample_data",))
    (fault,) = check_dataset(copied).faults.found
    assert (fault.code, fault.rows, Path(fault.place.file).stem) == ("DST-028", 24, "sample_data")
    assert "frames have stamps from 1990 to 2100" in str(fault)


def test_stamps_of_annotations_have_the_same_rules(copied_annotated: Path) -> None:
    def changed(by: Callable[[int], Any]) -> Callable[[dict[str, Any]], object]:
        def change(content: dict[str, Any]) -> None:
            for frame in (frame for one in content["scene_infos"].values() for frame in one.values()):
                frame["timestamp"] = by(int(frame["timestamp"]))

        return change

    reannotated(copied_annotated, changed(lambda us: us - FIRST_US))
    assert not check_dataset(copied_annotated).faults.found
    reannotated(copied_annotated, changed(lambda us: us // 1000))
    fault, *_ = check_dataset(copied_annotated).faults.found
    assert (fault.code, fault.rows) == ("DST-028", 3)
    assert "milliseconds instead of integer microseconds" in str(fault)


def all_rows(name: str, **values: Any) -> Callable[[Path], object]:
    return table(name, lambda rows: [one.update(values) for one in rows])


def in_names(change: Callable[[str], str]) -> Callable[[Path], object]:
    return table("sample_data", lambda rows: [one.update(filename=change(one["filename"])) for one in rows])


def counted(rows: Rows) -> None:
    for number, one in enumerate(rows):
        one["token"] = number


MISTAKES: dict[str, tuple[Callable[[Path], object], str, str]] = {
    "backslashes": (in_names(lambda name: name.replace("/", "\\")), "DST-004", "has backslashes (paths use /"),
    "absolute paths": (in_names(lambda name: f"/data/{name}"), "DST-004", "the path is absolute; paths must start"),
    "paths from the working folder": (
        in_names(lambda name: f"data/nuscenes/{name}"), "DST-041", "remove 'data/nuscenes'"),
    "paths that begin with a dot": (in_names(lambda name: f"./{name}"), "DST-041", "remove '.'"),
    "names without folders": (in_names(lambda name: name.rpartition("/")[2]), "DST-041", "a file name without its"),
    "folders in small letters": (
        in_names(lambda name: name.replace("samples/LIDAR_TOP", "samples/lidar_top")),
        "DST-041",
        "differ in upper and lower case",
    ),
    "tokens in capitals": (table("sample", lambda rows: rows[0].update(token="AB" * 16)), "DST-017", "token.lower()"),
    "tokens that are counters": (table("sample", counted), "DST-016", "a number; tokens are text of 32 hex digits"),
    "tokens that are names": (row("sample", 0, token="frame_0001"), "DST-017", "instead of 32 hex digits"),
    "tokens that are stamps": (row("sample", 0, token=f"{FIRST_US}"), "DST-017", "instead of 32 hex digits"),
    "tokens of 40 digits": (row("sample", 0, token="a" * 40), "DST-017", "40 hex digits instead of 32"),
    "dashes at odd places": (row("sample", 0, token="a-" * 31 + "a"), "DST-017", "dashes at other positions"),
    "rotations that are objects": (
        all_rows("ego_pose", rotation={"w": 1, "x": 0, "y": 0, "z": 0}), "DST-016", "a list of numbers"),
    "numbers as text": (all_rows("ego_pose", translation=["1", "2.5", "0"]), "DST-016", "numbers written as text"),
    "null in a pose": (all_rows("ego_pose", translation=[1, None, 0]), "DST-016", "null in a list of numbers"),
    "no pose": (all_rows("ego_pose", translation=None), "DST-016", "null: the value was never filled in"),
    "a rotation that was never filled in": (all_rows("ego_pose", rotation=[0, 0, 0, 0]), "DST-022", "never filled in"),
    "key frames as 0 and 1": (all_rows("sample_data", is_key_frame=1), "DST-016", "JSON has true and false"),
    "a lens that is NaN": (
        row("calibrated_sensor", 1, camera_distortion=[float("nan")] * 5), "DST-020", "calibration of the camera"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_named_by_what_it_is(mistake: str, copied: Path) -> None:
    edit, code, cause = MISTAKES[mistake]
    edit(copied)
    faults = check_dataset(copied).faults
    assert {fault.code for fault in faults.found} == {code}
    assert len(faults.found) == 1
    assert cause in str(faults.found[0])


def line_of(message: str) -> str:
    """The command that a message has, run by this Python."""
    return sys.executable + " " + message.partition("python ")[2].rpartition('"')[0] + '"'


def test_the_line_for_backslashes_in_a_table_mends_it(copied: Path) -> None:
    MISTAKES["backslashes"][0](copied)
    (fault,) = check_dataset(copied).faults.found
    subprocess.run(line_of(str(fault)), shell=True, cwd=copied, check=True)
    assert not check_dataset(copied).faults.found


def test_the_line_for_backslashes_in_a_zip_mends_it(good: Path, tmp_path: Path) -> None:
    sound = Path(make_archive(str(tmp_path / "sound"), "zip", good))
    with ZipFile(sound) as old, ZipFile(tmp_path / "old.zip", "w") as new:
        for name in old.namelist():
            new.writestr(name.replace("/", "\\"), old.read(name))
    (fault,) = check_dataset(tmp_path / "old.zip").faults.found
    assert fault.code == "DST-004"
    subprocess.run(line_of(str(fault)), shell=True, cwd=tmp_path, check=True)
    assert not check_dataset(tmp_path / "new.zip").faults.found


@pytest.mark.parametrize(
    ("written", "cause"),
    {
        "a byte order mark": (lambda text: b"\xef\xbb\xbf" + text, "byte order mark"),
        "UTF-16 of PowerShell": (lambda text: text.decode().encode("utf-16"), "UTF-16"),
        "Python's repr": (lambda text: repr(json.loads(text)).encode(), "json.dump"),
        "cut off": (lambda text: text[: len(text) // 2], "cut off"),
        "rows of JSON lines": (lambda text: b"\n".join(json.dumps(r).encode() for r in json.loads(text)), "[{…}, …]"),
        "a comma at the end": (lambda text: text.rstrip()[:-1] + b",]", "comma"),
    }.values(),
)
def test_a_table_that_is_no_json_is_refused_with_how_it_was_written(
    written: Callable[[bytes], bytes], cause: str, good: Path, tmp_path: Path
) -> None:
    folder = copytree(good, tmp_path / "copied")
    path = folder / VERSION / "ego_pose.json"
    path.write_bytes(written(path.read_bytes()))
    assert cause in str(check_dataset(folder).faults.found[0])


SHAPE = PAPER.shape
GRIDS: dict[str, tuple[np.ndarray[Any, Any], str, str]] = {
    "z first": (np.zeros((SHAPE[2], *SHAPE[:2]), np.uint8), "DST-063", "grid.transpose(1, 2, 0)"),
    "a batch axis": (np.zeros((1, *SHAPE), np.uint8), "DST-063", "grid[0]"),
    "doubles": (np.zeros(SHAPE, np.float64), "DST-064", ".astype(numpy.uint8)"),
    "bools": (np.zeros(SHAPE, bool), "DST-064", ".astype(numpy.uint8)"),
    "int64": (np.zeros(SHAPE, np.int64), "DST-064", ".astype(numpy.uint8)"),
    "Fortran order": (np.zeros(SHAPE, np.uint8, order="F"), "DST-064", "ascontiguousarray"),
}


@pytest.mark.parametrize("grid", GRIDS)
def test_labels_in_another_form_are_refused_with_what_makes_the_right_one(grid: str, copied: Path) -> None:
    array, code, cause = GRIDS[grid]
    name = f"gts/field-0000/{GOOD.tokens(0)[0]}/labels.npz"
    seen = np.ones(SHAPE, np.uint8)
    np.savez_compressed(copied / name, semantics=array, mask_lidar=seen, mask_camera=seen)
    (fault,) = check_dataset(copied).faults.found
    assert (fault.code, cause in str(fault)) == (code, True)
