"""Measure a recording: what its sensors delivered, what their messages hold, and the score that follows.

**Conventions.** Topics have the roles that the inspection gave them. What cannot be read is left out with its reason,
as a finding; it is never a failure.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from services.ingest.bag import Bag
from services.ingest.inspection import Inspection
from services.ingest.quality.cameras import CameraLook
from services.ingest.quality.clouds import LidarLook, RadarLook
from services.ingest.quality.coverage import coverage_of
from services.ingest.quality.facts import Facts, RtkFacts
from services.ingest.quality.rtk import RTK_TYPES, RtkLook
from services.ingest.quality.sampling import sample
from services.ingest.quality.score import Deduction, deductions_of, score_of
from services.ingest.quality.watched import cameras_of, of_role
from stone.findings import Finding

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


def quality_of(bag: Bag, inspection: Inspection) -> Quality:
    """Of a recording without messages the score is what its findings leave. Raises nothing for what a message says."""
    facts, refused = _facts(bag, inspection)
    named = {(finding.code, finding.topic) for finding in inspection.findings}
    left_out = tuple(finding for finding in refused if (finding.code, finding.topic) not in named)
    deductions = deductions_of((*inspection.findings, *left_out), facts)
    return Quality(score_of(deductions), deductions, facts, left_out)


def _facts(bag: Bag, inspection: Inspection) -> tuple[Facts, tuple[Finding, ...]]:
    cameras = [CameraLook(topic, channel) for topic, channel in cameras_of(inspection)]
    lidars = [LidarLook(topic) for topic in of_role(inspection, "lidar")]
    radars = [RadarLook(topic) for topic in of_role(inspection, "radar")]
    fixes = [RtkLook(topic) for topic in of_role(inspection, "gnss", "ins") if topic.type in RTK_TYPES]
    looks = [*(one.look for one in cameras), *(one.look for one in lidars), *(one.look for one in radars)]
    looks += [one.look for one in fixes]
    left_out = sample(bag, looks)
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
