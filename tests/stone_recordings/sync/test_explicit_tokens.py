"""Frame tokens in the file of a sequence: those of a published dataset are kept, those that follow are not stored."""

import io
import json
from dataclasses import replace

import numpy as np

from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration
from stone.sensors.sequence import Frames, Sequence, frame_token
from stone_recordings.sync.sequence_file import read_sequence, sequence_bytes

STAMPS_NS = np.array([1_700_000_000_123_456_000, 1_700_000_000_223_456_000], np.int64)
POSES = SE3(np.array([[1.0, 0, 0, 0, 1, 2, 3], [1.0, 0, 0, 0, 4, 5, 6]]))
FOREIGN = ("0f" * 16, "a0" * 16)


def test_tokens_that_do_not_follow_from_name_and_stamps_are_read_back() -> None:
    sequence = _sequence(FOREIGN)
    read = read_sequence(sequence_bytes(sequence))
    assert read.frames.tokens == FOREIGN
    assert sequence_bytes(read) == sequence_bytes(sequence)


def test_one_token_that_does_not_follow_keeps_all_of_them() -> None:
    mixed = (_derived()[0], FOREIGN[1])
    assert read_sequence(sequence_bytes(_sequence(mixed))).frames.tokens == mixed


def test_tokens_that_follow_from_name_and_stamps_are_not_stored_and_read_all_the_same() -> None:
    written = sequence_bytes(_sequence(_derived()))
    with np.load(io.BytesIO(written), allow_pickle=False) as arrays:
        assert "tokens" not in json.loads(arrays["record"].tobytes())
    assert read_sequence(written).frames.tokens == _derived()


def test_a_sequence_without_frames_stores_no_tokens() -> None:
    empty = Frames(STAMPS_NS[:0], (), POSES[:0])
    assert read_sequence(sequence_bytes(replace(_sequence(FOREIGN), frames=empty))).frames.tokens == ()


def _derived() -> tuple[str, ...]:
    return tuple(frame_token("run", stamp) for stamp in STAMPS_NS.tolist())


def _sequence(tokens: tuple[str, ...]) -> Sequence:
    return Sequence("run", Frames(STAMPS_NS, tokens, POSES), (), Calibration("rig", SE3.identity()), "dataset")
