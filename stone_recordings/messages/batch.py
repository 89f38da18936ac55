"""Shared parts of the decoders of many small messages: payloads in, checked poses out.

**Conventions.** A decoder takes anything that has a `payload`; positions are metres, quaternions arrive as ROS writes
them (xyzw) and leave as `wxyz`.
"""

from collections.abc import Iterable, Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone_recordings.bags.errors import PoseValueError

# Drivers write (0, 0, 0, 0) for "unknown"; rounding to float32 or to four decimals stays far above this.
LEAST_NORM = 1e-3
MOST_COMPONENT = 1e6
BATCH_BYTES = 16 << 20


class StampedMessage(Protocol):
    """A recorded message, such as `RawMessage`."""

    @property
    def payload(self) -> memoryview: ...


def payloads_of(messages: Iterable[StampedMessage]) -> list[memoryview]:
    return [message.payload for message in messages]


def payload_batches(messages: Iterable[StampedMessage]) -> Iterator[list[memoryview]]:
    """The payloads in portions of some megabytes: a reader that inflates chunks need not keep them all."""
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


def poses(translation_m: NDArray[np.float64], xyzw: NDArray[np.float64], type_name: str) -> SE3:
    """Batch (N,) from (N, 3) and (N, 4); raises PoseValueError for the first pose that is none."""
    is_finite = np.isfinite(translation_m).all(axis=1) & np.isfinite(xyzw).all(axis=1)
    if not is_finite.all():
        raise PoseValueError(type_name, int(np.argmin(is_finite)), "is not finite")
    largest = np.abs(xyzw).max(axis=1, initial=0.0)
    if (largest > MOST_COMPONENT).any():  # its square would overflow
        row = int(np.argmax(largest > MOST_COMPONENT))
        raise PoseValueError(type_name, row, f"has a quaternion component of {largest[row]:.3g}")
    norms = np.linalg.norm(xyzw, axis=1)
    if (norms < LEAST_NORM).any():
        row = int(np.argmax(norms < LEAST_NORM))
        raise PoseValueError(type_name, row, f"has a quaternion of norm {norms[row]:.3g}")
    return SE3.from_parts(xyzw[:, [3, 0, 1, 2]], translation_m)
