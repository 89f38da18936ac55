"""The quality report: measures a recording's topics and messages, and scores it.

**Conventions.** Topics have the roles that the inspection gave them. What cannot be read is left out with its reason,
as a finding; it is never a failure.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from stone.findings import Finding
from stone_recordings.bags.bag import Bag
from stone_recordings.report.inspection import Inspection
from stone_recordings.report.quality.cameras import CameraLook
from stone_recordings.report.quality.clouds import LidarLook, RadarLook
from stone_recordings.report.quality.coverage import coverage_of
from stone_recordings.report.quality.facts import Facts, RtkFacts
from stone_recordings.report.quality.rtk import RTK_TYPES, RtkLook
from stone_recordings.report.quality.sampling import SampledMessages, sample
from stone_recordings.report.quality.score import Deduction, deductions_of, score_of
from stone_recordings.report.quality.watched_topics import cameras_of, of_role

MOST_LEFT_OUT = 100


@dataclass(frozen=True)
class Quality:
    """`score` is 0 to 100; `left_out` are the findings about sampled messages that could not be read,
    where the inspection has not named the same already."""

    score: int
    deductions: tuple[Deduction, ...]
    facts: Facts
    left_out: tuple[Finding, ...]

    def as_record(self) -> dict[str, object]:
        """Bounded, whatever the recording: it is kept in a row."""
        return {
            "score": self.score,
            "deductions": [deduction.as_record() for deduction in self.deductions],
            "left_out": [finding.as_record() for finding in self.left_out[:MOST_LEFT_OUT]],
            **self.facts.as_record(),
        }


def quality_of(bag: Bag, inspection: Inspection, sampled: SampledMessages | None = None) -> Quality:
    """Of a recording without messages the score is what its findings leave; `sampled` keeps small messages that were
    looked at. Raises nothing for what a message says."""
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
    looks = [*(one.look for one in cameras), *(one.look for one in lidars), *(one.look for one in radars)]
    looks += [one.look for one in fixes]
    left_out = sample(bag, looks, sampled)
    facts = Facts(
        bag.start_ns,
        coverage_of(bag, inspection),
        tuple(seen for camera in cameras if (seen := camera.facts())),
        tuple(found for lidar in lidars if (found := lidar.facts())),
        tuple(scans for radar in radars if (scans := radar.facts())),
        _best_rtk(fixes),
    )
    return facts, left_out


def _best_rtk(looks: Sequence[RtkLook]) -> RtkFacts | None:
    """Of several: the type that `RTK_TYPES` names first, then the one seen most often."""
    found = [(RTK_TYPES.index(look.topic.type), -len(rtk.words), rtk) for look in looks if (rtk := look.facts())]
    return min(found, key=lambda one: one[:2])[2] if found else None
