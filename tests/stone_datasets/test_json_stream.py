"""The streaming reader of JSON gives what `json` gives, in pieces of any size, and refuses what it refuses."""

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone_datasets import json_stream
from stone_datasets.faults import DatasetFaultError
from stone_datasets.json_stream import JsonStream, json_rows
from stone_datasets.layout_faults import TooManyRowsError
from stone_exports import files
from stone_exports.files import ExportFileSpan

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


@settings(max_examples=60)
@given(rows=ROWS, piece=st.integers(1, 40), indent=st.none() | st.integers(0, 3), is_ascii=st.booleans())
def test_rows_are_those_of_json_in_pieces_of_any_size(
    folder: Path, rows: list[dict[str, Any]], piece: int, indent: int | None, is_ascii: bool
) -> None:
    content = json.dumps(rows, indent=indent, ensure_ascii=is_ascii).encode("utf-8", "surrogatepass")
    if not is_ascii and b"\xed" in content:
        return  # half of a surrogate pair is no UTF-8
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files, "PIECE_BYTES", piece)
        assert list(json_rows(span_of(folder, content))) == list(enumerate(rows, 1))


@settings(max_examples=60)
@given(rows=ROWS, piece=st.integers(1, 40), data=st.data())
def test_what_json_refuses_is_refused_and_what_it_reads_is_read(
    folder: Path, rows: list[dict[str, Any]], piece: int, data: st.DataObject
) -> None:
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


def test_a_table_of_too_many_rows_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(json_stream, "MOST_ROWS", 3)
    assert len(list(json_rows(span_of(folder, b"[{},{},{}]")))) == 3
    with pytest.raises(TooManyRowsError, match="more than 3 rows"):
        list(json_rows(span_of(folder, b"[{},{},{},{}]")))


def test_a_file_that_another_shortens_meanwhile_is_refused(folder: Path) -> None:
    content = b'[{"a": 1}]'
    (folder / "table.json").write_bytes(content)
    longer = ExportFileSpan(folder / "table.json", "table.json", 0, len(content) + 5)
    with pytest.raises(DatasetFaultError, match="ends early"):
        list(json_rows(longer))
