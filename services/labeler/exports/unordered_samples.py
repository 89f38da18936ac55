"""A sequence whose frames have no poses, stamps or order, for inputs that do not reveal its labels.

**Conventions.** A phase selects the frames and orders them by its tokens. The robot is at the origin in each frame.
Stamps follow this order, one second apart, and each sensor has its frame's stamp: dt drifts with time, so it would
reveal the order. Sweeps stay deskewed, and radar rates stay compensated. Pictures lose their metadata.
"""

from collections.abc import Sequence as Listing
from dataclasses import dataclass, replace

import numpy as np

from stone.geometry.se3 import SE3
from stone.sensors.samples import CameraSample, LidarSample, RadarSample, SampleSource
from stone.sensors.sequence import Association, Frames, Sequence

STEP_NS = 10**9
START_OF_SCAN, APPLICATION, COMMENT = 0xDA, range(0xE0, 0xF0), 0xFE
KEPT_APPLICATION = (0xE0, 0xEE)  # JFIF and Adobe: the picture's coding


def without_order(
    sequence: Sequence, samples: SampleSource, chosen: Listing[tuple[str, int]]
) -> tuple[Sequence, SampleSource]:
    """Return the sequence of these frames (token, place in time), and their samples."""
    places = np.array([position for _, position in chosen], np.int64)

    def associated(association: Association) -> Association:
        return Association(association.topic, association.message_index[places], np.zeros(len(places), np.int64))

    own = sequence.frames
    frames = Frames(
        np.arange(len(places), dtype=np.int64) * STEP_NS,
        tuple(token for token, _ in chosen),
        SE3(np.tile(SE3.identity().wxyz_xyz, (len(places), 1))),
        {name: associated(link) for name, link in own.associations.items()},
        sweeps=None if own.sweeps is None else associated(own.sweeps),
    )
    kept = Sequence(sequence.name, frames, (), sequence.calibration, "none")
    return kept, UnorderedSamples(samples, tuple(places.tolist()))


@dataclass(frozen=True, eq=False)
class UnorderedSamples:
    """The samples of the frames at these places of a sequence. Picklable if the samples are."""

    samples: SampleSource
    places: tuple[int, ...]

    def lidar(self, index: int) -> LidarSample:
        return self.samples.lidar(self.places[index])

    def camera(self, channel: str, index: int) -> CameraSample | None:
        picture = self.samples.camera(channel, self.places[index])
        return None if picture is None else replace(picture, content=bare_jpeg(picture.content))

    def radar(self, channel: str, index: int) -> RadarSample | None:
        return self.samples.radar(channel, self.places[index])


def bare_jpeg(content: bytes) -> bytes:
    """Return a JPEG without metadata segments and without bytes after its end.

    If the segments cannot be parsed, the result ends at the first bad segment.
    """
    kept, at = [content[:2]], 2
    while content[at : at + 1] == b"\xff" and at + 4 <= len(content):
        kind, length = content[at + 1], int.from_bytes(content[at + 2 : at + 4], "big")
        if kind == START_OF_SCAN:
            end = content.rfind(b"\xff\xd9")
            return b"".join(kept) + content[at : end + 2 if end > at else len(content)]
        if kind != COMMENT and (kind not in APPLICATION or kind in KEPT_APPLICATION):
            kept.append(content[at : at + 2 + length])
        at += 2 + length
    return b"".join(kept)
