"""Recordings whose quality is known because it was written that way.

**Conventions.** Written with `mcap` and `rosbags`; pictures with Pillow, positions with pymap3d (`rigs`).
"""

from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from stone_recordings.bags.bag import open_bag
from stone_recordings.report.inspection import Inspection, inspect
from stone_recordings.report.quality.report import Quality, quality_of
from tests.stone_recordings.rigs import INS_TOPIC, T0_NS, ins_messages
from tests.stone_recordings.writing import HESAI, CloudText, Recorded, cloud_payload, header, made, serialised, sweep

LIDAR, RADAR = "/lidar_points", "/radar/front"
MS = 1_000_000


def ticks(seconds: float, rate_hz: float, start_s: float = 0.0) -> NDArray[np.int64]:
    """Stamps of `rate_hz` for `seconds`."""
    return T0_NS + round(start_s * 1e9) + (np.arange(round(seconds * rate_hz)) * (1e9 / rate_hz)).astype(np.int64)


def photo(brightness: int, contrast: int, seed: int, size_px: tuple[int, int] = (96, 60)) -> bytes:
    """A PNG of noise around a brightness."""
    generator = np.random.default_rng(seed)
    pixels = generator.integers(brightness - contrast, brightness + contrast + 1, (size_px[1], size_px[0], 3))
    stream = BytesIO()
    Image.fromarray(np.clip(pixels, 0, 255).astype(np.uint8)).save(stream, "PNG")
    return stream.getvalue()


def picture(topic: str, stamp_ns: int, content: bytes) -> Recorded:
    message = made(
        "sensor_msgs/msg/CompressedImage",
        header=header(stamp_ns, "cam"),
        format="whatever",
        data=np.frombuffer(content, np.uint8),
    )
    return Recorded(topic, "sensor_msgs/msg/CompressedImage", stamp_ns + MS, serialised(message))


def pictures(topic: str, stamps_ns: NDArray[np.int64], brightness: int = 128, contrast: int = 40) -> list[Recorded]:
    return [
        picture(topic, int(stamp), photo(brightness, contrast, seed)) for seed, stamp in enumerate(stamps_ns.tolist())
    ]


def clouds(stamps_ns: NDArray[np.int64], valid: int = 900, count: int = 1200) -> list[Recorded]:
    """Hesai sweeps of which the first `valid` of `count` points returned, the rest are zeros."""
    recorded = []
    for stamp in stamps_ns.tolist():
        points = sweep(HESAI, count, seed=stamp % 1000, stamp_ns=stamp)
        for name in "xyz":
            points[name][valid:] = 0
        payload = cloud_payload(points, CloudText(stamp_ns=stamp))
        recorded.append(Recorded(LIDAR, "sensor_msgs/msg/PointCloud2", stamp + 100 * MS, payload))
    return recorded


def solutions(stamps_ns: NDArray[np.int64], pos_type: int) -> list[Recorded]:
    return ins_messages(stamps_ns, pos_type=pos_type)


def measured(path: Path) -> tuple[Inspection, Quality]:
    inspection = inspect(path)
    with open_bag(path) as bag:
        return inspection, quality_of(bag, inspection)


__all__ = ["INS_TOPIC", "LIDAR", "RADAR", "T0_NS", "clouds", "measured", "photo", "picture", "pictures", "solutions"]
