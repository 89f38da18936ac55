"""tf2_msgs/msg/TFMessage: any number of transforms a message, sorted by pair of frames.

**Conventions.** `parent_from_child` maps `child` to `parent` coordinates. Samples of a pair are in the order of the
messages; pairs in order of their names. Source: tf2_msgs, geometry_msgs (Humble), REP 105.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.ingest.cdr import Cursor, Field, Group, groups
from services.ingest.messages.batch import Stamped, payloads_of, poses
from stone.se3 import SE3

TYPE = "tf2_msgs/msg/TFMessage"
# Two stamps' words, two strings of one byte with their lengths, three and four doubles.
LEAST_TRANSFORM_BYTES = 8 + 2 * 5 + 7 * 8


@dataclass(frozen=True, eq=False)
class TransformSamples:
    """N transforms of one pair of frames."""

    parent: str
    child: str
    stamps_ns: NDArray[np.int64]
    parent_from_child: SE3


@dataclass(frozen=True, eq=False)
class _Column:
    """One place in the messages of a group, as rows of (message number, place, stamp, translation, quaternion)."""

    keys: NDArray[np.int64]
    pairs: list[tuple[str, str]]
    stamps_ns: NDArray[np.int64]
    values: NDArray[np.float64]


def decode_transforms(messages: Iterable[Stamped]) -> tuple[TransformSamples, ...]:
    """One value per (parent, child). Raises: MessageLayoutError, ByteOrderError, PoseValueError."""
    columns: list[_Column] = []
    for group in groups(payloads_of(messages), _fields, TYPE):
        count = int(group.table["transforms.length"][0])
        columns += [_column(group, place) for place in range(count)]
    if not columns:
        return ()
    order = np.lexsort(np.concatenate([column.keys for column in columns]).T[::-1])
    stamps_ns = np.concatenate([column.stamps_ns for column in columns])[order]
    values = np.concatenate([column.values for column in columns])[order]
    unordered = [pair for column in columns for pair in column.pairs]
    rows_of: dict[tuple[str, str], list[int]] = {}
    for row, source in enumerate(order.tolist()):
        rows_of.setdefault(unordered[source], []).append(row)
    transforms = poses(values[:, :3], values[:, 3:], TYPE)
    return tuple(
        TransformSamples(*pair, stamps_ns[rows], transforms[np.array(rows)]) for pair, rows in sorted(rows_of.items())
    )


def _fields(payload: memoryview) -> list[Field]:
    fields: list[Field] = [("transforms", "count")]
    for place in range(Cursor(payload, TYPE).count(LEAST_TRANSFORM_BYTES)):
        fields += [(f"sec{place}", "i4"), (f"nanosec{place}", "u4"), (f"parent{place}", "string")]
        fields += [(f"child{place}", "string"), (f"values{place}", "7f8")]
    return fields


def _column(group: Group, place: int) -> _Column:
    pairs = zip(group.texts(f"parent{place}", TYPE), group.texts(f"child{place}", TYPE), strict=True)
    return _Column(
        np.stack([group.rows, np.full(len(group.rows), place)], axis=1),
        list(pairs),
        group.stamps_ns(f"sec{place}", f"nanosec{place}"),
        group.table[f"values{place}"].astype(np.float64),
    )
