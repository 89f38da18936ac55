"""The released dataset is read as it lies: its ZIP, its grid, key and tokens; what does not fit together is refused.

The twin is written by a formula that knows nothing of the reader; voxels and returns are compared by that formula.
Twins with one thing wrong are in test_released_wrong.py.
"""

import json
import zipfile
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from stone_base.label_grid import PAPER, RELEASE
from stone_datasets.classes import OWN_CLASSES, class_map_of
from stone_datasets.faults import DatasetPlace
from stone_datasets.labels import read_labels
from stone_datasets.reading import DatasetCheck, check_dataset, read_dataset
from stone_datasets.stated_layout import StatedLayout, form_of_tokens
from stone_files.dataset_layouts import LAYOUTS
from stone_files.grid_file import chosen_grid
from stone_files.npz import npz_bytes
from testing.refusals import refused_as
from testing.worlds.released_datasets import (
    ReleasedDataset,
    released_files,
    write_released,
    write_released_zip,
)

TWIN = ReleasedDataset(frames=5)


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_released_zip(tmp_path_factory.mktemp("release") / "STONE.zip", TWIN)


def refusal(check: DatasetCheck) -> tuple[str, str]:
    """The only code, and the first sentence."""
    (code,) = {fault.code for fault in check.faults.found}
    return code, str(check.faults.found[0])


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_world_in_each_layout_is_recognised_and_its_returns_lie_in_its_labels(tmp_path: Path, name: str) -> None:
    layout = LAYOUTS[name]
    check = check_dataset(write_released_zip(tmp_path / "world.zip", replace(TWIN, layout=layout)))
    assert [str(fault) for fault in check.faults.found] == []
    assert check.contents is not None
    record = check.contents.as_record()
    assert (record["layout"], record["grid"]) == (name, layout.grid.as_record())
    assert record["masks"]["mask_lidar"] == record["frames"] == 10
    assert record["returns_in_occupied"]["own_frame"]["as stated"] > 0.999
    assert record["returns_in_occupied"]["frame_near_by"]["as stated"] > 0.998


def test_unknown_voxels_are_free_and_unobserved_and_tokens_lose_their_dashes(twin: Path) -> None:
    index = read_dataset(twin)
    sequence = index.sequences[1]
    assert sequence.tokens == TWIN.tables.tokens(1)
    for frame, token in enumerate(sequence.tokens):
        span = index.labels(sequence, frame)
        assert span is not None
        assert span.name == f"gts/{sequence.name}/{TWIN.written(token)}/labels.npz"
        given = np.load(BytesIO(span.read(2**20)))["label"]
        labels = read_labels(span, OWN_CLASSES, index.layout)
        assert labels.mask_lidar is not None
        assert set(np.unique(given)) == {0, 1, 2, 3, 255}
        assert np.array_equal(labels.mask_lidar == 0, given == 255)
        assert np.array_equal(labels.classes, np.where(given == 255, 0, given))


def test_a_zip_a_folder_and_a_stored_zip_are_the_same_dataset(tmp_path: Path, twin: Path) -> None:
    records = [
        check.contents.as_record()
        for check in (
            check_dataset(twin),
            check_dataset(write_released_zip(tmp_path / "stored.zip", replace(TWIN, is_deflated=False))),
            check_dataset(write_released(tmp_path / "folder", TWIN)),
        )
        if check.contents is not None
    ]
    assert records[0] == records[1] == records[2]


def test_every_file_of_the_zip_is_read_to_the_byte(twin: Path) -> None:
    files = read_dataset(twin).files
    for name, content in released_files(TWIN):
        span = files.span(name)
        assert span is not None
        assert (span.size_bytes, span.read(2**26)) == (len(content), content)
        for start in (0, 1, len(content) // 2, len(content)):
            assert span.part(start, 100) == content[start:][:100]


def test_boxes_and_pickles_are_never_opened(tmp_path: Path) -> None:
    """A pickle that runs a command, and annotations that are no JSON, are files like any other."""
    folder = write_released(tmp_path, TWIN)
    (folder / "v1.0-trainval" / "sample_annotation.json").write_bytes(b"\x80\x04.")
    check = check_dataset(folder)
    assert check.contents is not None, refusal(check)


def test_what_is_stated_goes_before_what_is_recognised_and_must_be_what_the_files_hold(
    tmp_path: Path, twin: Path
) -> None:
    assert refusal(check_dataset(twin, stated=StatedLayout(grid=PAPER)))[0] == "DST-063"
    check = check_dataset(twin, stated=StatedLayout("paper"))  # whose sweeps have no rows without a return
    assert {fault.code for fault in check.faults.found} == {"DST-052", "DST-062"}
    assert check_dataset(twin, stated=StatedLayout("release")).contents is not None
    with refused_as("bad_layout"):
        check_dataset(twin, stated=StatedLayout("nuscenes"))
    (tmp_path / "grid.json").write_text(json.dumps(RELEASE.as_record()))
    assert chosen_grid(str(tmp_path / "grid.json")) == RELEASE
    assert chosen_grid("paper") == PAPER
    (tmp_path / "grid.json").write_text("[1")
    for name in ("cubic", str(tmp_path / "grid.json")):
        with refused_as("bad_grid"):
            chosen_grid(name)


def test_tokens_of_two_forms_are_counted() -> None:
    with refused_as("DST-043", match="1 of 3 frame tokens have dashes"):
        form_of_tokens(["0" * 32, TWIN.written("1" * 32), "2" * 32], DatasetPlace("sample.json"))


def test_labels_of_class_17_are_read_if_it_is_named(tmp_path: Path) -> None:
    folder = write_released(tmp_path, TWIN)
    path = next(folder.glob("gts/*/*/labels.npz"))
    grid = np.load(path)["label"]
    path.write_bytes(npz_bytes({"label": np.where(grid == 3, 17, grid).astype(np.uint8)}))
    named = class_map_of("named", {0: "free", 1: "T", 2: "P", 3: "N", 17: "N"})
    assert check_dataset(folder, named).contents is not None


# Hostile zips: each is the twin with one thing wrong.


def with_record(raw: bytes, change: Callable[[bytearray, int], None], which: int = 5) -> bytes:
    """The zip with a change at the `which`-th record of its directory."""
    damaged = bytearray(raw)
    at = int.from_bytes(raw[-6:-2], "little")
    for _ in range(which):
        at += 46 + sum(int.from_bytes(raw[at + off : at + off + 2], "little") for off in (28, 30, 32))
    change(damaged, at)
    return bytes(damaged)


def put(offset: int, content: bytes) -> Callable[[bytearray, int], None]:
    def change(raw: bytearray, at: int) -> None:
        raw[at + offset : at + offset + len(content)] = content

    return change


def renamed(raw: bytes, to: bytes) -> bytes:
    """The sixth file by another name, of the same length, in both of its headers."""
    name = zipfile.ZipFile(BytesIO(raw)).namelist()[5].encode()
    return raw.replace(name, to + name[len(to) :])


HOSTILE: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    "cut off": ("DST-006", lambda raw: raw[:-1000]),
    "bytes behind": ("DST-006", lambda raw: raw + b"x"),
    "an absolute name": ("DST-004", lambda raw: renamed(raw, b"/")),
    "a name above": ("DST-004", lambda raw: renamed(raw, b"../")),
    "a name of backslashes": ("DST-004", lambda raw: renamed(raw, b"a\\")),
    "a link": ("DST-004", lambda raw: with_record(raw, put(38, b"\0\0\0\xa1"))),
    "encrypted": ("DST-008", lambda raw: with_record(raw, put(8, b"\1"))),
    "another method": ("DST-006", lambda raw: with_record(raw, put(10, b"\x0c"))),
    "overlapping": ("DST-007", lambda raw: with_record(raw, put(42, bytes(4)))),
    "larger than its place": ("DST-007", lambda raw: with_record(raw, put(20, b"\xff\xff\xff\x7f"))),
    "a bomb": ("DST-009", lambda raw: with_record(raw, put(24, b"\xff\xff\xff\xfe"))),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_zips_are_refused_by_their_code(tmp_path: Path, twin: Path, name: str) -> None:
    code, change = HOSTILE[name]
    (tmp_path / "bad.zip").write_bytes(change(twin.read_bytes()))
    assert refusal(check_dataset(tmp_path / "bad.zip"))[0] == code


def test_two_files_of_one_name_are_refused(tmp_path: Path, twin: Path) -> None:
    raw = twin.read_bytes()
    first, second = (zipfile.ZipFile(BytesIO(raw)).namelist()[at].encode() for at in (-1, -4))
    assert len(first) == len(second)
    (tmp_path / "twice.zip").write_bytes(raw.replace(second, first))
    assert refusal(check_dataset(tmp_path / "twice.zip"))[0] == "DST-006"


def test_a_member_that_inflates_to_more_or_other_bytes_than_declared_is_damaged(tmp_path: Path, twin: Path) -> None:
    raw = twin.read_bytes()
    infos = zipfile.ZipFile(BytesIO(raw)).infolist()
    sweep = next(at for at, one in enumerate(infos) if "LIDAR_TOP" in one.filename)
    size = infos[sweep].file_size
    for change in (put(24, (size - 20).to_bytes(4, "little")), put(16, b"\0\0\0\0")):
        (tmp_path / "bad.zip").write_bytes(with_record(raw, change, sweep))
        assert refusal(check_dataset(tmp_path / "bad.zip"))[0] == "DST-051"
