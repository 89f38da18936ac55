"""What a child hands over arrives whole, and what is no parcel is refused before it is kept."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.runtime.sandbox.errors import SandboxCrashedError
from services.runtime.sandbox.result_files import HEAD, MEDIA_TYPES, MOST_FILES, SandboxResult, packed, unpacked

FILES = st.lists(
    st.tuples(
        st.from_regex(r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,20}", fullmatch=True), st.sampled_from(MEDIA_TYPES), st.binary()
    ),
    max_size=5,
)


@given(st.dictionaries(st.text(), st.integers() | st.text() | st.none()), FILES)
def test_a_parcel_arrives_as_it_was_sent(record: dict[str, object], files: list[tuple[str, str, bytes]]) -> None:
    assert unpacked(packed(record, files)) == SandboxResult(record, tuple(files))


def headed(head: object, rest: bytes = b"") -> bytes:
    written = json.dumps(head).encode()
    return HEAD.pack(len(written)) + written + rest


NONSENSE = {
    "nothing": b"",
    "a length without bytes": HEAD.pack(100),
    "a length beyond reason": HEAD.pack(2**32 - 1) + bytes(100),
    "no JSON": HEAD.pack(4) + b"\xff\xff\xff\xff",
    "JSON without end": HEAD.pack(50_000) + b"[" * 50_000,
    "a list": headed([]),
    "no record": headed({"files": []}),
    "a record that is a text": headed({"record": "x", "files": []}),
    "more bytes than files": headed({"record": {}, "files": []}, b"x"),
    "fewer bytes than files": headed({"record": {}, "files": [["a.png", "image/png", 2]]}, b"x"),
    "a file of negative length": headed({"record": {}, "files": [["a.png", "image/png", -1]]}, b""),
    "a path for a name": headed({"record": {}, "files": [["../a.png", "image/png", 0]]}),
    "a hidden name": headed({"record": {}, "files": [[".a.png", "image/png", 0]]}),
    "a media type that browsers run": headed({"record": {}, "files": [["a.js", "text/javascript", 0]]}),
    "a file of three words less": headed({"record": {}, "files": [["a.png"]]}),
    "too many files": headed({"record": {}, "files": [["a.png", "image/png", 0]] * (MOST_FILES + 1)}),
}


@pytest.mark.parametrize("case", NONSENSE)
def test_what_is_no_parcel_is_a_crash(case: str) -> None:
    with pytest.raises(SandboxCrashedError, match="something else than what was asked"):
        unpacked(NONSENSE[case])
