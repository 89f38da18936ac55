"""Words and parcels of a child arrive whole however they are cut, and what is none is refused before it is kept."""

import json
import os
from collections.abc import Iterator
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.runtime.sandbox.errors import SandboxCrashedError
from services.runtime.sandbox.messages import (
    ANSWER,
    HEAD,
    LONGEST_JSON_BYTES,
    REFUSAL,
    TICK,
    SandboxMessage,
    SandboxMessageReader,
    texts_of,
    tick_of,
)
from services.runtime.sandbox.result_files import HEAD as PARCEL_HEAD
from services.runtime.sandbox.result_files import MEDIA_TYPES, MOST_FILES, SandboxResult, packed, unpacked

ANSWER_BYTES = 100
WORDS = st.lists(st.builds(SandboxMessage, st.sampled_from([TICK, ANSWER, REFUSAL]), st.binary(max_size=ANSWER_BYTES)))


def heard(pieces: Iterator[bytes] | list[bytes]) -> list[SandboxMessage]:
    """What an inbox makes of these pieces, written one after another and then closed."""
    reading, writing = os.pipe()
    os.set_blocking(reading, False)
    reader, words = SandboxMessageReader(reading, ANSWER_BYTES), list[SandboxMessage]()
    try:
        for piece in pieces:
            os.write(writing, piece)
            words += reader.words()
        os.close(writing)
        words += reader.words()
        assert reader.is_closed
    finally:
        os.close(reading)
        if not reader.is_closed:
            os.close(writing)
    return words


@given(WORDS, st.lists(st.integers(0, 1000)))
def test_words_arrive_whole_and_in_order_however_they_are_cut(words: list[SandboxMessage], cuts: list[int]) -> None:
    stream = b"".join(HEAD.pack(word.kind, len(word.payload)) + word.payload for word in words)
    places = [0, *sorted(cut for cut in cuts if cut < len(stream)), len(stream)]
    assert heard([stream[a:b] for a, b in pairwise(places)]) == words


@pytest.mark.parametrize(
    "noise",
    [
        HEAD.pack(99, 0),
        HEAD.pack(ANSWER, ANSWER_BYTES + 1),
        HEAD.pack(ANSWER, 2**64 - 1),
        HEAD.pack(REFUSAL, LONGEST_JSON_BYTES + 1),
        b"\xff" * 100,
    ],
)
def test_what_is_no_word_is_refused_by_its_head(noise: bytes) -> None:
    with pytest.raises(SandboxCrashedError):
        heard([noise])


def test_a_word_that_breaks_off_is_not_heard() -> None:
    assert heard([HEAD.pack(ANSWER, 10) + b"nine char"]) == []


@pytest.mark.parametrize("payload", [b"", b"{}", b"[1]", b'["s", 1, "2"]', b'["s", 1, 2, 3]', b"[" * 50_000, b"\xff"])
def test_progress_that_is_none_is_refused(payload: bytes) -> None:
    with pytest.raises(SandboxCrashedError):
        SandboxMessage(TICK, payload).tick()


@pytest.mark.parametrize("payload", [b"", b"[]", b"7", b"[" * 50_000])
def test_texts_that_are_none_are_empty(payload: bytes) -> None:
    assert SandboxMessage(REFUSAL, payload).texts() == {}


@given(st.text(), st.integers(0, 10**9), st.integers(0, 10**9))
def test_progress_survives_but_for_a_long_stage(stage: str, done: int, total: int) -> None:
    assert SandboxMessage(TICK, tick_of(stage, done, total)).tick() == (stage[:100], done, total)


def test_texts_are_cut_to_what_a_word_may_hold() -> None:
    payload = texts_of(**{name: "\U0001f4a3" * 10_000 for name in ("module", "name", "sentence")})
    assert len(payload) <= LONGEST_JSON_BYTES
    assert {len(text) for text in json.loads(payload).values()} == {2000}


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
    return PARCEL_HEAD.pack(len(written)) + written + rest


NONSENSE = {
    "nothing": b"",
    "a length without bytes": PARCEL_HEAD.pack(100),
    "a length beyond reason": PARCEL_HEAD.pack(2**32 - 1) + bytes(100),
    "no JSON": PARCEL_HEAD.pack(4) + b"\xff\xff\xff\xff",
    "JSON without end": PARCEL_HEAD.pack(50_000) + b"[" * 50_000,
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
    with pytest.raises(SandboxCrashedError):
        unpacked(NONSENSE[case])
