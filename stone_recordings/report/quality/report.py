"""The quality report: measures a recording's topics and messages, and scores it.

**Conventions.** Topics have the roles of the inspection. Unreadable parts are left out and reported in a finding; they
never cause a failure.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone_recordings.bags.bag import Bag, RawMessage, Topic
from stone_recordings.messages.camera import decode_image
from stone_recordings.messages.novatel import FixSamples, InsSamples, decode_bestpos, decode_inspva
from stone_recordings.messages.pointcloud2 import lidar_points
from stone_recordings.messages.radars.radar import decode_radar
from stone_recordings.messages.sweep_clouds import sweep_cloud
from stone_recordings.report.inspection import Inspection
from stone_recordings.report.quality.coverage import coverage_of
from stone_recordings.report.quality.facts import CameraFacts, Facts, LidarFacts, RadarFacts, RtkFacts, RtkWord
from stone_recordings.report.quality.sampling import (
    HEAVY,
    LIGHT,
    TINY,
    SampledMessages,
    TopicSampling,
    cameras_of,
    of_role,
    sample,
)
from stone_recordings.report.quality.score import Deduction, deductions_of, score_of

# Share of valid measurements in a LiDAR's and a radar's messages. A slot without a return is NaN or (0, 0, 0)
# (`stone_recordings.messages.lidar`); drivers that leave such slots out have a valid share of 1. Ranges are from the
# sensor.


MOST_RANGE_M = 1e4


class LidarLook:
    """Collects facts about the clouds of one topic."""

    def __init__(self, topic: Topic) -> None:
        self._topic = topic
        self._seen: list[tuple[int, int, float, float]] = []

    @property
    def look(self) -> TopicSampling:
        return TopicSampling(self._topic, self._see, HEAVY)

    def _see(self, at_ns: int, payload: memoryview) -> None:
        cloud = sweep_cloud(payload, self._topic.type)
        points_lidar = lidar_points(cloud).points_lidar
        slots = len(cloud.points)
        range_m = _median_range_m(points_lidar)
        self._seen.append((at_ns, slots, len(points_lidar) / max(1, slots), range_m))

    def facts(self) -> LidarFacts | None:
        """Return the facts; None if no cloud could be read."""
        if not self._seen:
            return None
        at_ns, slots, valid_ratio, range_m = zip(*self._seen, strict=True)
        return LidarFacts(self._topic.name, at_ns, slots, valid_ratio, range_m)


def _median_range_m(points_lidar: NDArray[np.float32]) -> float:
    """Return the median range, at most `MOST_RANGE_M`; 0 for no points."""
    within = np.nan_to_num(np.abs(points_lidar), nan=MOST_RANGE_M, posinf=MOST_RANGE_M)
    ranges_m = np.linalg.norm(np.minimum(within, MOST_RANGE_M).astype(np.float64), axis=1)
    return min(float(np.median(ranges_m)), MOST_RANGE_M) if len(ranges_m) else 0.0


class RadarLook:
    """Collects the number of detections in the messages of one topic."""

    def __init__(self, topic: Topic) -> None:
        self._topic = topic
        self._seen: list[tuple[int, int]] = []

    @property
    def look(self) -> TopicSampling:
        return TopicSampling(self._topic, self._see, LIGHT)

    def _see(self, at_ns: int, payload: memoryview) -> None:
        detections = decode_radar(self._topic.type, [RawMessage(at_ns, 0, payload)], self._topic.schema)
        self._seen.append((at_ns, int(np.count_nonzero(detections.is_valid))))

    def facts(self) -> RadarFacts | None:
        """Return the facts; None if no message could be read."""
        if not self._seen:
            return None
        at_ns, detections = zip(*self._seen, strict=True)
        return RadarFacts(self._topic.name, at_ns, detections)


# Sharpness and exposure of each camera's pictures. Pictures are first scaled to at most `WIDTH_PX`, so that cameras of
# different sizes compare and a JPEG is decoded at a fraction of its size. Luminance is Rec. 601 of 8-bit RGB. Source of
# the measure: Pech-Pacheco et al., "Diatom autofocusing in brightfield microscopy", ICPR 2000 (variance of the
# Laplacian).


WIDTH_PX = 640
DARK_LEVEL, BRIGHT_LEVEL = 8, 247
REC_601 = np.array([0.299, 0.587, 0.114], np.float32)


@dataclass(frozen=True)
class PictureFacts:
    """The facts of one picture; see `CameraFacts`."""

    size_px: tuple[int, int]
    sharpness: float
    brightness_ratio: float
    dark_ratio: float
    bright_ratio: float


class CameraLook:
    """Collects facts about the pictures of one topic."""

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
        """Return the facts; None if no picture could be read."""
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
    """Return the facts of (H, W, 3) RGB, scaled down from a picture of `size_px`."""
    luminance = pixels @ REC_601
    return PictureFacts(
        size_px,
        sharpness(luminance),
        float(luminance.mean()) / 255.0,
        float((luminance <= DARK_LEVEL).mean()),
        float((luminance >= BRIGHT_LEVEL).mean()),
    )


def sharpness(luminance: NDArray[np.float32]) -> float:
    """Return the variance of the 4-neighbour Laplacian of (H, W); 0 for pictures too small to have one."""
    if min(luminance.shape) < 3:
        return 0.0
    centre = luminance[1:-1, 1:-1]
    around = luminance[:-2, 1:-1] + luminance[2:, 1:-1] + luminance[1:-1, :-2] + luminance[1:-1, 2:]
    return float(np.var(around - 4 * centre, dtype=np.float64))


# RTK quality: the share of fixes, and the receiver's own estimate of its accuracy. Words follow NovAtel's position
# types (OEM7 "Position or Velocity Type"): resolved integer ambiguities are "fixed", float ones "float", all others
# (single, PPP, none) "other". NavSatFix does not distinguish RTK from DGPS, so it is not used.


BESTPOS, INSPVAX = "novatel_oem7_msgs/msg/BESTPOS", "novatel_oem7_msgs/msg/INSPVAX"
RTK_TYPES = (BESTPOS, INSPVAX)
WORD_OF_TYPE: dict[int, RtkWord] = {
    **dict.fromkeys((48, 49, 50, 56), "fixed"),  # L1_INT, WIDE_INT, NARROW_INT, INS_RTKFIXED
    **dict.fromkeys((32, 33, 34, 55), "float"),  # L1_FLOAT, IONOFREE_FLOAT, NARROW_FLOAT, INS_RTKFLOAT
}
MOST_STDEV_M = 1e4


class RtkLook:
    """Collects the solution types of one topic."""

    def __init__(self, topic: Topic) -> None:
        self.topic = topic
        self._seen: list[tuple[int, RtkWord, float]] = []

    @property
    def look(self) -> TopicSampling:
        return TopicSampling(self.topic, self._see, TINY)

    def _see(self, at_ns: int, payload: memoryview) -> None:
        samples = decode_solution(self.topic, RawMessage(at_ns, 0, payload))
        if samples.pos_type is not None and samples.position_stdev_m is not None:
            word = WORD_OF_TYPE.get(int(samples.pos_type[0]), "other")
            self._seen.append((at_ns, word, _horizontal_m(samples.position_stdev_m[0])))

    def facts(self) -> RtkFacts | None:
        """Return the facts; None if the receiver sent nothing."""
        if not self._seen:
            return None
        at_ns, words, stdev_m = zip(*self._seen, strict=True)
        return RtkFacts(self.topic.name, at_ns, words, stdev_m)


def decode_solution(topic: Topic, message: RawMessage) -> FixSamples | InsSamples:
    """Decode one sample with the definition in the recording. Raises the errors of `decode_bestpos`."""
    if topic.type == BESTPOS:
        return decode_bestpos([message], topic.schema)
    return decode_inspva([message], topic.schema)


def _horizontal_m(stdev_m: NDArray[np.float64]) -> float:
    """Return the larger of the two axes; impossible values (NaN, kilometres) become the largest kept value."""
    larger_m = float(np.max(np.abs(stdev_m[:2])))
    return larger_m if larger_m <= MOST_STDEV_M else MOST_STDEV_M


MOST_LEFT_OUT = 100


@dataclass(frozen=True)
class Quality:
    """`score` is 0 to 100; `left_out` are the findings about unreadable sampled messages, unless the inspection has
    them.
    """

    score: int
    deductions: tuple[Deduction, ...]
    facts: Facts
    left_out: tuple[Finding, ...]

    def as_record(self) -> dict[str, object]:
        """Return a record of bounded size: a database row holds it."""
        return {
            "score": self.score,
            "deductions": [deduction.as_record() for deduction in self.deductions],
            "left_out": [finding.as_record() for finding in self.left_out[:MOST_LEFT_OUT]],
            **self.facts.as_record(),
        }


def quality_of(bag: Bag, inspection: Inspection, sampled: SampledMessages | None = None) -> Quality:
    """Measure the quality; without messages the score follows from the findings alone.

    `sampled` keeps small messages that were read. Raises nothing because of a message's content.
    """
    facts, refused = _facts(bag, inspection, sampled)
    named = {(finding.code, finding.topic) for finding in inspection.findings}
    left_out = tuple(finding for finding in refused if (finding.code, finding.topic) not in named)
    deductions = deductions_of((*inspection.findings, *left_out), facts)
    return Quality(score_of(deductions), deductions, facts, left_out)


def _facts(bag: Bag, inspection: Inspection, sampled: SampledMessages | None) -> tuple[Facts, tuple[Finding, ...]]:
    cameras = [CameraLook(topic, channel) for topic, channel in cameras_of(inspection)]
    lidars = [LidarLook(topic) for topic in of_role(inspection, "lidar")]
    radars = [RadarLook(topic) for topic in of_role(inspection, "radar")]
    fixes = [RtkLook(topic) for topic in of_role(inspection, "gnss", "ins") if topic.type in RTK_TYPES]
    looks = [
        *(sensor.look for sensor in cameras),
        *(sensor.look for sensor in lidars),
        *(sensor.look for sensor in radars),
    ]
    looks += [sensor.look for sensor in fixes]
    left_out = sample(bag, looks, sampled)
    facts = Facts(
        bag.start_ns,
        coverage_of(bag, inspection),
        tuple(seen for camera in cameras if (seen := camera.facts())),
        tuple(measured for lidar in lidars if (measured := lidar.facts())),
        tuple(scans for radar in radars if (scans := radar.facts())),
        _best_rtk(fixes),
    )
    return facts, left_out


def _best_rtk(looks: Sequence[RtkLook]) -> RtkFacts | None:
    """Return the best of several: the type that `RTK_TYPES` names first, then the one with most samples."""
    ranked = [(RTK_TYPES.index(look.topic.type), -len(rtk.words), rtk) for look in looks if (rtk := look.facts())]
    return min(ranked, key=lambda entry: entry[:2])[2] if ranked else None
