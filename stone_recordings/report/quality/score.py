"""The score of a recording: 100 minus deductions, each with its code, its points and its reason.

**Conventions.** A deduction is measured (coverage, RTK, pictures, clouds) or follows from a finding; a finding about a
measured quantity costs nothing a second time. Points are whole, a code costs at most its limit, the score is 0 to 100.
The weights are a judgement with this one home: 5 is a nuisance, 10 costs frames, 30 costs labels.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass

from stone.findings import Finding
from stone_recordings.report.quality.facts import CameraFacts, Coverage, Facts, LidarFacts, RadarFacts, RtkFacts, middle

FULL_SCORE = 100
# By code: points for each finding, and the limit of the code.
POINTS_OF_CODE: Mapping[str, tuple[int, int]] = {
    "BAG-010": (10, 20),
    "TOP-101": (40, 40),
    "TOP-103": (25, 25),
    "TIM-201": (1, 3),
    "TIM-202": (8, 16),
    "TIM-203": (5, 15),
    "TIM-204": (2, 10),
    "TIM-208": (5, 20),
    "GNS-302": (8, 16),
    "MSG-309": (1, 3),
}
POINTS_OF_SEVERITY: Mapping[str, tuple[int, int]] = {"error": (15, 30), "warning": (4, 12), "info": (0, 0)}
MEASURED_CODES = frozenset({"GNS-301"})
# Roles whose silence costs frames, rows or checks.
SENSOR_ROLES = frozenset({"lidar", "camera", "radar", "gnss", "ins", "imu", "odometry"})
USUAL_COVERED, POINTS_UNCOVERED, MOST_UNCOVERED = 0.99, 60, 25
USUAL_RTK, POINTS_RTK = 0.95, 20
# A lens with mud on it is several times less sharp than the five beside it; scenes alone differ by two or three.
BLURRED_RATIO, LEAST_PEERS, FLAT_SHARPNESS = 0.15, 3, 1.0
MOST_CLIPPED_RATIO = 0.4
USUAL_VALID_RATIO, EMPTY_RADAR_RATIO = 0.2, 0.2


@dataclass(frozen=True)
class Deduction:
    """The recording's loss for one code, and the reason in one sentence."""

    code: str
    points: int
    message: str

    def as_record(self) -> dict[str, object]:
        return asdict(self)


def score_of(deductions: Iterable[Deduction]) -> int:
    """Return the score, 0 to 100."""
    return max(0, FULL_SCORE - sum(deduction.points for deduction in deductions))


def deductions_of(findings: Sequence[Finding], facts: Facts) -> tuple[Deduction, ...]:
    """Return the deductions that cost points, largest first, then by code."""
    deductions = [*_measured(facts), *_found(findings)]
    return tuple(
        sorted(
            (deduction for deduction in deductions if deduction.points),
            key=lambda deduction: (-deduction.points, deduction.code),
        )
    )


def _measured(facts: Facts) -> Iterator[Deduction]:
    yield from _uncovered(facts.coverage)
    if facts.rtk is not None:
        yield from _rtk(facts.rtk)
    yield from _blurred(facts.cameras)
    yield from _exposed(facts.cameras)
    yield from _lidars(facts.lidars)
    yield from _radars(facts.radars)


def _found(findings: Sequence[Finding]) -> Iterator[Deduction]:
    by_code: dict[str, list[Finding]] = {}
    for finding in findings:
        if finding.code not in MEASURED_CODES:
            by_code.setdefault(finding.code, []).append(finding)
    for code, listed in by_code.items():
        costs = [POINTS_OF_CODE.get(code, POINTS_OF_SEVERITY[finding.severity]) for finding in listed]
        points = sum(
            each if finding.severity != "info" else 0 for finding, (each, _) in zip(listed, costs, strict=True)
        )
        yield Deduction(code, min(points, max(most for _, most in costs)), _said(listed))


def _said(listed: Sequence[Finding]) -> str:
    first = listed[0]
    more = f" (and {len(listed) - 1} more of this kind)" if len(listed) > 1 else ""
    return f"{first.topic}: {first.message}{more}" if first.topic else f"{first.message}{more}"


def _uncovered(coverage: Sequence[Coverage]) -> Iterator[Deduction]:
    silent = {
        topic.topic: 1.0 - topic.covered_ratio
        for topic in coverage
        if topic.role in SENSOR_ROLES and topic.covered_ratio is not None and topic.covered_ratio < USUAL_COVERED
    }
    if silent:
        worst = max(silent, key=lambda name: silent[name])
        points = min(MOST_UNCOVERED, max(1, round(POINTS_UNCOVERED * sum(silent.values()))))
        message = f"{len(silent)} sensors have gaps, {worst} for {silent[worst] * 100:.1f} % of the recording."
        yield Deduction("QLT-601", points, message)


def _rtk(rtk: RtkFacts) -> Iterator[Deduction]:
    share = rtk.share("fixed")
    if share < USUAL_RTK:
        points = max(1, round(POINTS_RTK * (USUAL_RTK - share) / USUAL_RTK))
        message = f"RTK was fixed only {share * 100:.1f} % of the time ({rtk.share('float') * 100:.1f} % float)."
        yield Deduction("GNS-301", points, f"{rtk.topic}: {message}")


def _blurred(cameras: Sequence[CameraFacts]) -> Iterator[Deduction]:
    medians = {camera.topic: middle(camera.sharpness) or 0.0 for camera in cameras}
    usual = middle(list(medians.values())) or 0.0
    limit = max(FLAT_SHARPNESS, BLURRED_RATIO * usual if len(medians) >= LEAST_PEERS else 0.0)
    blurred = [topic for topic, value in medians.items() if value < limit]
    if blurred:
        message = f"{_names(blurred)} much less sharp than the other cameras: check the lens and its focus."
        yield Deduction("QLT-602", min(15, 5 * len(blurred)), message)


def _exposed(cameras: Sequence[CameraFacts]) -> Iterator[Deduction]:
    clipped = [
        camera.topic
        for camera in cameras
        if max(middle(camera.dark_ratio) or 0.0, middle(camera.bright_ratio) or 0.0) > MOST_CLIPPED_RATIO
    ]
    if clipped:
        message = f"{_names(clipped)} black or white over {MOST_CLIPPED_RATIO * 100:.0f} % of the image."
        yield Deduction("QLT-603", min(9, 3 * len(clipped)), message)


def _lidars(lidars: Sequence[LidarFacts]) -> Iterator[Deduction]:
    poor = [lidar.topic for lidar in lidars if (middle(lidar.valid_ratio) or 0.0) < USUAL_VALID_RATIO]
    if poor:
        message = f"{_names(poor)} with fewer than {USUAL_VALID_RATIO * 100:.0f} % of the points returned."
        yield Deduction("QLT-604", min(20, 10 * len(poor)), message)


def _radars(radars: Sequence[RadarFacts]) -> Iterator[Deduction]:
    empty = [radar.topic for radar in radars if radar.detections.count(0) > EMPTY_RADAR_RATIO * len(radar.detections)]
    if empty:
        message = f"{_names(empty)} without a detection in over {EMPTY_RADAR_RATIO * 100:.0f} % of the scans."
        yield Deduction("QLT-605", min(9, 3 * len(empty)), message)


def _names(topics: Sequence[str]) -> str:
    return f"{', '.join(topics[:3])}{' …' if len(topics) > 3 else ''} {'is' if len(topics) == 1 else 'are'}"
