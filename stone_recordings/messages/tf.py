"""tf2_msgs/msg/TFMessage: any number of transforms a message, sorted by pair of frames.

**Conventions.** `parent_from_child` maps `child` to `parent` coordinates. Samples of a pair are in the order of the
messages; pairs in order of their names. Source: tf2_msgs, geometry_msgs (Humble), REP 105.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone_recordings.messages.batch import Poses, StampedMessage, poses_in
from stone_recordings.messages.types.cdr import NS_PER_S
from stone_recordings.messages.types.table import MessageTable, decode_table

TYPE = "tf2_msgs/msg/TFMessage"


@dataclass(frozen=True, eq=False)
class TransformSamples:
    """N transforms of one pair of frames; `refused_ns` (R,) are the stamps of invalid ones, `reason` is that of the
    first.
    """

    parent: str
    child: str
    stamps_ns: NDArray[np.int64]
    parent_from_child: SE3
    refused_ns: NDArray[np.int64]
    reason: str


def decode_transforms(messages: Iterable[StampedMessage]) -> tuple[TransformSamples, ...]:
    """Return one value per (parent, child) with a transform. Raises: MessageLayoutError, ByteOrderError, and
    PoseValueError if none is valid.
    """
    table = decode_table(TYPE, messages)
    stamps_ns = _numbers(table, "header.stamp.sec").astype(np.int64) * NS_PER_S
    stamps_ns += _numbers(table, "header.stamp.nanosec")
    translations = np.stack([_numbers(table, f"transform.translation.{axis}") for axis in "xyz"], axis=1)
    rotations = np.stack([_numbers(table, f"transform.rotation.{axis}") for axis in "xyzw"], axis=1)
    poses = poses_in(translations, rotations, TYPE)
    pairs = sorted(_rows_of_pairs(table).items())
    every = (_samples(pair, np.array(rows), stamps_ns, poses) for pair, rows in pairs)
    return tuple(samples for samples in every if len(samples.stamps_ns))


def _samples(
    pair: tuple[str, str], rows: NDArray[np.int64], stamps_ns: NDArray[np.int64], poses: Poses
) -> TransformSamples:
    """Return the samples of one pair, whose transforms are these rows of all."""
    is_pose = np.isin(rows, poses.rows)
    own = poses.poses[np.searchsorted(poses.rows, rows[is_pose])]
    refused_ns = stamps_ns[rows[~is_pose]]
    return TransformSamples(*pair, stamps_ns[rows[is_pose]], own, refused_ns, poses.reason if len(refused_ns) else "")


def _numbers(table: MessageTable, name: str) -> NDArray[Any]:
    """Return one value per transform, in the order of the messages."""
    return table.ragged(f"transforms.{name}")[1]


def _rows_of_pairs(table: MessageTable) -> dict[tuple[str, str], list[int]]:
    parents, children = (table.ragged_texts(f"transforms.{name}")[1] for name in ("header.frame_id", "child_frame_id"))
    rows: dict[tuple[str, str], list[int]] = {}
    for row, pair in enumerate(zip(parents, children, strict=True)):
        rows.setdefault(pair, []).append(row)
    return rows
