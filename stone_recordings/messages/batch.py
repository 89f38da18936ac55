"""Shared parts of the decoders of many small messages: payloads in, checked poses out.

**Conventions.** A decoder takes any object with a `payload`; positions are metres, quaternions arrive in ROS' order
(xyzw) and leave as `wxyz`.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone.geometry.se3 import SE3
from stone_recordings.bags.errors import PoseValueError

# Drivers write (0, 0, 0, 0) for "unknown", and some write angles; rounding to two decimals stays far below this.
MOST_OFF_NORM, LEAST_ANGLES, ONE_SCALE = 0.1, 1e-3, 0.01
MOST_COMPONENT = 1e6  # the square of more would overflow
# Beyond any position in any frame on Earth: ECEF reaches 6.4e6 m, a UTM zone 1e7 m.
MOST_POSITION_M = 1e8
BATCH_BYTES = 16 << 20
SHOWN = 3


class StampedMessage(Protocol):
    """A recorded message, such as `RawMessage`."""

    @property
    def payload(self) -> memoryview: ...


def payloads_of(messages: Iterable[StampedMessage]) -> list[memoryview]:
    return [message.payload for message in messages]


def payload_batches(messages: Iterable[StampedMessage]) -> Iterator[list[memoryview]]:
    """Yield the payloads in portions of some megabytes, so that a reader that inflates chunks need not keep all."""
    batch: list[memoryview] = []
    size_bytes = 0
    for message in messages:
        batch.append(message.payload)
        size_bytes += len(message.payload)
        if size_bytes >= BATCH_BYTES:
            yield batch
            batch, size_bytes = [], 0
    if batch:
        yield batch


@dataclass(frozen=True, eq=False)
class Poses:
    """`poses` (M,) of the messages `rows` (M,); `refused` are the numbers of the others, and the reason for the
    first.
    """

    poses: SE3
    rows: NDArray[np.int64]
    refused: NDArray[np.int64]
    reason: str


def poses_in(translation_m: NDArray[np.float64], xyzw: NDArray[np.float64], type_name: str) -> Poses:
    """Return the poses among N messages, from (N, 3) and (N, 4). Raises PoseValueError, for the first, if none is
    valid.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        is_finite = np.isfinite(np.concatenate([translation_m, xyzw], axis=1)).all(axis=1)
        largest = np.abs(xyzw).max(axis=1, initial=0.0)
        norms = np.linalg.norm(xyzw, axis=1)
        is_pose = is_finite & (largest <= MOST_COMPONENT) & are_turns(norms)
        farthest_m = np.abs(translation_m).max(axis=1, initial=0.0)
        is_pose &= farthest_m <= MOST_POSITION_M
    rows, refused = np.flatnonzero(is_pose), np.flatnonzero(~is_pose)
    measured = (is_finite, largest, norms, farthest_m)
    reason = _problem(*(values[refused[0]] for values in measured)) if len(refused) else ""
    if len(refused) and not len(rows):
        raise PoseValueError(type_name, int(refused[0]), reason)
    return Poses(SE3.from_parts(xyzw[rows][:, [3, 0, 1, 2]], translation_m[rows]), rows, refused, reason)


def are_turns(norms: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which quaternions are rotations, by their norms (N,): norm 1, or the norm that most share.

    None are if most are angles, whose norms differ, although one of them may be 1.
    """
    known = norms[norms >= LEAST_ANGLES]
    if not len(known):
        return np.zeros(len(norms), np.bool_)
    usual = float(np.median(known))
    is_scaled = float((np.abs(known - usual) <= ONE_SCALE * usual).mean()) >= 0.5
    is_turn = np.abs(norms / (usual if is_scaled else 1.0) - 1.0) <= MOST_OFF_NORM
    return np.asarray(is_turn & (2 * int(is_turn.sum()) >= len(known)))


def refused_finding(topic: str, refused_ns: NDArray[np.int64], reason: str) -> tuple[Finding, ...]:
    """Return MSG-305 for messages of a topic, by their stamps (R,), that are left out because they hold no pose."""
    if not len(refused_ns):
        return ()
    shown = ", ".join(str(stamp) for stamp in refused_ns[:SHOWN].tolist())
    more = f" and {len(refused_ns) - SHOWN} more" if len(refused_ns) > SHOWN else ""
    sentence = (
        f"{len(refused_ns)} messages contain no pose and are left out (stamps {shown}{more} ns; the first {reason})"
    )
    return (Finding("MSG-305", "warning", topic, sentence),)


def _problem(is_finite: np.bool_, largest: np.float64, norm: np.float64, farthest_m: np.float64) -> str:
    if not is_finite:
        return "is not finite"
    if largest > MOST_COMPONENT:
        return f"has a quaternion component of {largest:.3g}"
    if farthest_m > MOST_POSITION_M:
        return f"has a position of {farthest_m:.3g} m"
    hint = ", which is no rotation; if these are roll, pitch and yaw, convert them" if norm > LEAST_ANGLES else ""
    return f"has a quaternion of norm {norm:.3g}{hint}"
