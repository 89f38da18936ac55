"""Files of datasets: found in folders and tars, and never outside of them."""

import gzip
import io
import json
import tarfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone_datasets import json_stream
from stone_datasets.columns import NameColumn, repeated, rows_of
from stone_datasets.faults import DatasetFaultError
from stone_datasets.files import open_dataset
from stone_datasets.json_stream import JsonStream, json_rows
from stone_datasets.reading import check_dataset
from stone_exports import files
from stone_exports.files import ExportFileSpan
from testing.refusals import refused_as
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
    with refused_as("DST-004"):
        open_dataset(with_member(tmp_path / "bad.tar", name))


@pytest.mark.parametrize("kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE])
def test_a_tar_with_links_or_devices_is_refused(tmp_path: Path, kind: bytes) -> None:
    with refused_as("bad_tar"):
        check_dataset(with_member(tmp_path / "bad.tar", "samples/link", kind))


def test_a_tar_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    path = write_published_tar(tmp_path / "cut.tar", GOOD)
    content = path.read_bytes()
    for share in (0.3, 0.6, 0.9):
        path.write_bytes(content[: int(len(content) * share)])
        with refused_as("bad_tar"):
            check_dataset(path)


def test_a_compressed_tar_and_two_datasets_in_one_are_refused(tmp_path: Path) -> None:
    content = write_published_tar(tmp_path / "good.tar", GOOD).read_bytes()
    (tmp_path / "good.tar.gz").write_bytes(gzip.compress(content))
    check = check_dataset(tmp_path / "good.tar.gz")
    assert [fault.code for fault in check.faults.found] == ["DST-003"]
    with refused_as("DST-003"):
        open_dataset(tmp_path / "good.tar.gz")
    with refused_as("DST-002"):
        open_dataset(with_member(tmp_path / "two.tar", "other/v1.0-mini/scene.json"))


def test_links_to_or_within_the_dataset_are_followed(copied: Path) -> None:
    (copied / "kept").write_bytes((copied / SWEEP).read_bytes())
    linked(SWEEP, "kept")(copied)
    assert check_dataset(copied).contents is not None
    (copied.parent / "link").symlink_to(copied)
    assert check_dataset(copied.parent / "link").contents is not None


def test_names_come_back_as_given_and_keys_are_found_where_they_stand() -> None:
    names = NameColumn()
    given = ["", "a/b", "ü", "\ud800"]
    for name in given:
        names.add(name)
    assert [names[place] for place in range(len(names))] == given
    keys = np.array([5, -3, 9], np.int64)
    assert rows_of(keys, np.array([9, 5, 4, -3])).tolist() == [2, 0, -1, 1]
    assert rows_of(keys[:0], np.array([1])).tolist() == [-1]
    assert repeated([4, 7, 4, 7, 4]) == [(2, 0), (3, 1), (4, 0)]
    assert repeated([]) == []


SCALARS = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text()
VALUES = st.recursive(SCALARS, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=8)
ROWS = st.lists(st.dictionaries(st.text(), VALUES, max_size=4), max_size=6)


def span_of(folder: Path, content: bytes) -> ExportFileSpan:
    path = folder / "table.json"
    path.write_bytes(content)
    return ExportFileSpan(path, "table.json", 0, len(content))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("tables")


@settings(max_examples=30)
@given(rows=ROWS, piece=st.integers(1, 40), indent=st.none() | st.integers(0, 3), is_ascii=st.booleans())
def test_rows_are_those_of_json_in_pieces_of_any_size(folder, rows, piece, indent, is_ascii):
    content = json.dumps(rows, indent=indent, ensure_ascii=is_ascii).encode("utf-8", "surrogatepass")
    if not is_ascii and b"\xed" in content:
        return  # half of a surrogate pair is no UTF-8
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files, "PIECE_BYTES", piece)
        assert list(json_rows(span_of(folder, content))) == list(enumerate(rows, 1))


@settings(max_examples=30)
@given(rows=ROWS, piece=st.integers(1, 40), data=st.data())
def test_what_json_refuses_is_refused_and_what_it_reads_is_read(folder, rows, piece, data):
    text = json.dumps(rows)
    at = data.draw(st.integers(0, len(text)))
    changed = text[:at] + data.draw(st.sampled_from(["", ",", "]", "}", '"', "[", "1", "\\"])) + text[at + 1 :]
    try:
        wanted = json.loads(changed)
    except ValueError:
        wanted = None
    is_table = isinstance(wanted, list) and all(isinstance(row, dict) for row in wanted)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files, "PIECE_BYTES", piece)
        if is_table:
            assert [row for _, row in json_rows(span_of(folder, changed.encode()))] == wanted
        else:
            with pytest.raises(DatasetFaultError):
                list(json_rows(span_of(folder, changed.encode())))


def test_objects_are_walked_key_by_key(folder: Path) -> None:
    stream = JsonStream(span_of(folder, b' { "a" : [1, 2] , "b":{"c": 3}} '))
    found = {}
    for key in stream.items():
        found[key] = stream.value() if key == "a" else {inner: stream.value() for inner in stream.items()}
    stream.end()
    assert found == {"a": [1, 2], "b": {"c": 3}}


def test_a_table_of_too_many_rows_or_that_ends_early_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(json_stream, "MOST_ROWS", 3)
    assert len(list(json_rows(span_of(folder, b"[{},{},{}]")))) == 3
    with refused_as("DST-005"):
        list(json_rows(span_of(folder, b"[{},{},{},{}]")))
    content = b'[{"a": 1}]'
    (folder / "table.json").write_bytes(content)
    longer = ExportFileSpan(folder / "table.json", "table.json", 0, len(content) + 5)
    with pytest.raises(DatasetFaultError):
        list(json_rows(longer))
