"""Sharpness and exposure of each camera's pictures.

**Conventions.** Pictures are scaled to at most `WIDTH_PX` first, so that cameras of other sizes compare and a JPEG is
decoded at a fraction of its size. Luminance is Rec. 601 of 8-bit RGB. Source of the measure: Pech-Pacheco et al.,
"Diatom autofocusing in brightfield microscopy", ICPR 2000 (variance of the Laplacian).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.bag import Topic
from stone_recordings.messages.camera import decode_image
from stone_recordings.report.quality.facts import CameraFacts
from stone_recordings.report.quality.sampling import HEAVY, TopicSampling

WIDTH_PX = 640
DARK_LEVEL, BRIGHT_LEVEL = 8, 247
REC_601 = np.array([0.299, 0.587, 0.114], np.float32)


@dataclass(frozen=True)
class PictureFacts:
    """Of one picture; see `CameraFacts`."""

    size_px: tuple[int, int]
    sharpness: float
    brightness_ratio: float
    dark_ratio: float
    bright_ratio: float


class CameraLook:
    """Collects what the pictures of one topic are like."""

    def __init__(self, topic: Topic, channel: str) -> None:
        self._topic, self._channel = topic, channel
        self._seen: list[tuple[int, PictureFacts]] = []

    @property
    def look(self) -> TopicSampling:
        return TopicSampling(self._topic, self._see, HEAVY)

    def _see(self, at_ns: int, payload: memoryview) -> None:
        picture = decode_image(payload, self._topic.type)
        facts = picture_facts(picture.pixels(WIDTH_PX), (picture.width_px, picture.height_px))
        self._seen.append((at_ns, facts))

    def facts(self) -> CameraFacts | None:
        """None where not one picture could be seen."""
        if not self._seen:
            return None
        pictures = [picture for _, picture in self._seen]
        return CameraFacts(
            self._topic.name,
            self._channel,
            pictures[0].size_px,
            tuple(at_ns for at_ns, _ in self._seen),
            tuple(picture.sharpness for picture in pictures),
            tuple(picture.brightness_ratio for picture in pictures),
            tuple(picture.dark_ratio for picture in pictures),
            tuple(picture.bright_ratio for picture in pictures),
        )


def picture_facts(pixels: NDArray[np.uint8], size_px: tuple[int, int]) -> PictureFacts:
    """Of (H, W, 3) RGB, scaled down from a picture of `size_px`."""
    luminance = pixels @ REC_601
    return PictureFacts(
        size_px,
        sharpness(luminance),
        float(luminance.mean()) / 255.0,
        float((luminance <= DARK_LEVEL).mean()),
        float((luminance >= BRIGHT_LEVEL).mean()),
    )


def sharpness(luminance: NDArray[np.float32]) -> float:
    """Variance of the 4-neighbour Laplacian of (H, W); 0 for pictures too small to have one."""
    if min(luminance.shape) < 3:
        return 0.0
    centre = luminance[1:-1, 1:-1]
    around = luminance[:-2, 1:-1] + luminance[2:, 1:-1] + luminance[1:-1, :-2] + luminance[1:-1, 2:]
    return float(np.var(around - 4 * centre, dtype=np.float64))
