"""Files of datasets: found in folders and tars, and never outside of them."""

import gzip
import io
import tarfile
from pathlib import Path

import numpy as np
import pytest

from stone_datasets.columns import NameColumn, repeated, rows_of
from stone_datasets.files import open_dataset
from stone_datasets.reading import check_dataset
from stone_files.dataset_layout import CompressedDatasetError, PathLeavesDatasetError, TwoVersionsError
from stone_files.tar_index import BadTarError
from testing.worlds.published_datasets import write_published_tar
from tests.stone_datasets.conftest import GOOD
from tests.stone_datasets.malformed import SWEEP, linked


def with_member(path: Path, name: str, kind: bytes = tarfile.REGTYPE) -> Path:
    """The good dataset in a tar, with one thing more."""
    write_published_tar(path, GOOD)
    with tarfile.open(path, "a") as tar:
        member = tarfile.TarInfo(name)
        member.type, member.linkname, member.size = kind, "/etc/passwd", 0
        tar.addfile(member, io.BytesIO())
    return path


@pytest.mark.parametrize("name", ["../above", "/etc/passwd", "samples/../../x", "a\\b"])
def test_a_tar_whose_files_lead_outside_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(PathLeavesDatasetError, match="leads outside the dataset"):
        open_dataset(with_member(tmp_path / "bad.tar", name))


@pytest.mark.parametrize("kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE])
def test_a_tar_with_links_or_devices_is_refused(tmp_path: Path, kind: bytes) -> None:
    with pytest.raises(BadTarError, match="is a link or a device"):
        check_dataset(with_member(tmp_path / "bad.tar", "samples/link", kind))


def test_a_tar_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    path = write_published_tar(tmp_path / "cut.tar", GOOD)
    content = path.read_bytes()
    for share in (0.3, 0.6, 0.9):
        path.write_bytes(content[: int(len(content) * share)])
        with pytest.raises(BadTarError):
            check_dataset(path)


def test_a_compressed_tar_is_refused_with_what_to_do(tmp_path: Path) -> None:
    content = write_published_tar(tmp_path / "good.tar", GOOD).read_bytes()
    (tmp_path / "good.tar.gz").write_bytes(gzip.compress(content))
    check = check_dataset(tmp_path / "good.tar.gz")
    assert [fault.code for fault in check.faults.found] == ["DST-003"]
    with pytest.raises(CompressedDatasetError, match="`gunzip` it first"):
        open_dataset(tmp_path / "good.tar.gz")


def test_two_datasets_in_one_tar_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TwoVersionsError, match=r"other/v1\.0-mini"):
        open_dataset(with_member(tmp_path / "two.tar", "other/v1.0-mini/scene.json"))


def test_a_link_within_the_dataset_is_followed(copied: Path) -> None:
    (copied / "kept").write_bytes((copied / SWEEP).read_bytes())
    linked(SWEEP, "kept")(copied)
    assert check_dataset(copied).contents is not None


def test_the_dataset_itself_may_be_a_link(copied: Path) -> None:
    (copied.parent / "link").symlink_to(copied)
    assert check_dataset(copied.parent / "link").contents is not None


def test_names_come_back_as_they_were_given() -> None:
    names = NameColumn()
    given = ["", "a/b", "ü", "\ud800"]
    for name in given:
        names.add(name)
    assert [names[place] for place in range(len(names))] == given


def test_keys_are_found_where_they_stand() -> None:
    keys = np.array([5, -3, 9], np.int64)
    assert rows_of(keys, np.array([9, 5, 4, -3])).tolist() == [2, 0, -1, 1]
    assert rows_of(keys[:0], np.array([1])).tolist() == [-1]
    assert repeated([4, 7, 4, 7, 4]) == [(2, 0), (3, 1), (4, 0)]
    assert repeated([]) == []
