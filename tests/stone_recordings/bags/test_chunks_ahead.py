"""A pass that checks chunks has a thread inflate the next ones: it yields the same, and leaves nothing behind."""

import threading
from collections import Counter
from pathlib import Path

import pytest
from mcap.writer import CompressionType

from stone_recordings.bags import chunked_store
from stone_recordings.bags.bag import open_bag
from stone_recordings.bags.chunked_store import AHEAD_CHUNKS, KEPT_CHUNKS
from stone_recordings.bags.chunks import Chunk, inflate
from testing.worlds.faults.other_edits import bad_chunk
from tests.stone_recordings.bags.test_damaged_chunks import recorded

TOPICS = ("/a", "/b")


class CountedInflating:
    """`inflate`, with how often each chunk was inflated and which of them by another thread than the test's."""

    def __init__(self) -> None:
        self.times, self.ahead = Counter[int](), set[int]()

    def __call__(self, view: memoryview, chunk: Chunk) -> memoryview:
        self.times[chunk.start] += 1
        if threading.current_thread() is not threading.main_thread():
            self.ahead.add(chunk.start)
        return inflate(view, chunk)


@pytest.fixture
def inflating(monkeypatch: pytest.MonkeyPatch) -> CountedInflating:
    counted = CountedInflating()
    monkeypatch.setattr(chunked_store, "inflate", counted)
    return counted


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
@pytest.mark.parametrize("is_damaged", [False, True])
def test_every_chunk_is_inflated_once_and_ahead(
    tmp_path: Path, inflating: CountedInflating, compression: CompressionType, is_damaged: bool
) -> None:
    path = recorded(tmp_path / "run.mcap", compression=compression)
    with open_bag(path) as bag:
        plain = [(name, index, bytes(head)) for name, index, head in bag.heads(TOPICS, whole=TOPICS)]
    if is_damaged:
        bad_chunk(path)
    inflating.times.clear()
    with open_bag(path) as bag:
        checked = [(name, index, bytes(head)) for name, index, head in bag.heads(TOPICS, whole=TOPICS, is_checked=True)]
        assert set(inflating.times.values()) == {1}
        assert inflating.ahead == set(inflating.times)
        damaged = bag.damaged
        assert set(inflating.times.values()) == {1}
    assert checked == [(name, index, head) for name, index, head in plain if index not in damaged.get(name, {})]
    assert bool(damaged) is is_damaged


def test_large_chunks_are_inflated_when_it_is_their_turn(
    tmp_path: Path, inflating: CountedInflating, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chunked_store, "AHEAD_BYTES", 10)
    with open_bag(recorded(tmp_path / "run.mcap", compression=CompressionType.LZ4)) as bag:
        assert len(list(bag.heads(TOPICS, is_checked=True))) == 80
    assert len(inflating.times) > 3
    assert not inflating.ahead


def test_a_pass_that_is_given_up_leaves_no_thread_and_no_more_chunks(
    tmp_path: Path, inflating: CountedInflating
) -> None:
    threads = threading.active_count()
    with open_bag(recorded(tmp_path / "run.mcap", compression=CompressionType.LZ4)) as bag:
        heads = bag.heads(TOPICS, is_checked=True)
        next(heads)
        assert threading.active_count() == threads + 1
        heads.close()  # type: ignore[attr-defined]
        assert threading.active_count() == threads
        assert len(inflating.times) <= 1 + AHEAD_CHUNKS
        assert [bag.message("/a", index).payload[4] for index in range(40)] == list(range(40))
        store = bag._store
        assert len(store._chunks) <= KEPT_CHUNKS  # type: ignore[attr-defined]
