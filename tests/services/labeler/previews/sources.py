"""A labelled sequence that lies in memory: a bump on a plane, a wall, six cameras of one colour each."""

import io
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image

from services.labeler.exports.source import LabelledSequence
from stone.sensors.samples import CameraSample, LidarSample, RadarSample
from stone_base.label_grid import PAPER
from stone_files.npz import npz_bytes
from tests.services.labeler.worlds import World, sequence_of, stamp_of

COLOURS = {
    "CAM_FRONT_LEFT": (200, 30, 30),
    "CAM_FRONT": (30, 160, 30),
    "CAM_FRONT_RIGHT": (30, 30, 200),
    "CAM_BACK_LEFT": (180, 180, 40),
    "CAM_BACK": (40, 180, 180),
    "CAM_BACK_RIGHT": (180, 40, 180),
}
SIZE_PX = (64, 40)


@dataclass(frozen=True)
class Pictures:
    """Every picture has the colour of its camera; the channels of `silent` have none, of `broken` no JPEG."""

    silent: tuple[str, ...] = ()
    broken: tuple[str, ...] = ()

    def camera(self, channel: str, index: int) -> CameraSample | None:
        if channel in self.silent:
            return None
        content = b"\xff\xd8 no picture" if channel in self.broken else jpeg(COLOURS[channel])
        return CameraSample(stamp_of(index), content, *SIZE_PX)

    def lidar(self, index: int) -> LidarSample:
        raise NotImplementedError

    def radar(self, channel: str, index: int) -> RadarSample | None:
        raise NotImplementedError


@dataclass(frozen=True)
class Labels:
    """The ground at z index 9, T under the robot, a wall of N that comes nearer with every frame."""

    far: int = field(default=160)

    def __call__(self, index: int) -> bytes:
        semantics = np.zeros(PAPER.shape, np.uint8)
        semantics[60:200, 60:200, 9] = 2
        semantics[100:150, 126:130, 9] = 1
        semantics[self.far - 2 * index, 90:166, 10:20] = 3
        mask = np.zeros(PAPER.shape, np.uint8)
        mask[40:220, 40:220] = 1
        return npz_bytes({"semantics": semantics, "mask_lidar": mask, "mask_camera": mask})


def jpeg(colour: tuple[int, int, int]) -> bytes:
    file = io.BytesIO()
    Image.new("RGB", SIZE_PX, colour).save(file, "JPEG", quality=90)
    return file.getvalue()


def source_of(frames: int = 4, pictures: Pictures | None = None) -> LabelledSequence:
    sequence = sequence_of(World(frames=frames), "bumpy")
    nowhere = Path("nowhere")
    return LabelledSequence(sequence, pictures or Pictures(), Labels(), {}, nowhere, nowhere)
