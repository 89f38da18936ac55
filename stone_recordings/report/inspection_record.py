"""The stored record of an inspection: the same as `stone inspect --json`, bounded.

**Conventions.** A hostile recording may declare a hundred thousand topics with endless names; what is cut is counted.
"""

from itertools import islice
from typing import Any

from stone_recordings.report.inspection import InspectedTopic, Inspection

MOST_TOPICS, MOST_GAPS, MOST_FINDINGS = 300, 20, 200
LONGEST_TEXT = 300


def inspection_record(inspection: Inspection) -> dict[str, Any]:
    """`duration_ns`, `topics`, `findings` and how many of the last two there were."""
    frame_ids = {candidate.name: candidate.frame_id for candidate in inspection.candidates}
    return {
        "duration_ns": inspection.duration_ns,
        "topics": [_topic(topic, frame_ids.get(topic.topic.name, "")) for topic in inspection.topics[:MOST_TOPICS]],
        "topics_total": len(inspection.topics),
        "findings": [_short(finding.as_record()) for finding in inspection.findings[:MOST_FINDINGS]],
        "findings_total": len(inspection.findings),
        "clocks": _clocks(inspection),
        "channels": _short(dict(islice(inspection.assignment.channels.items(), MOST_TOPICS))),
    }


def _topic(topic: InspectedTopic, frame_id: str) -> dict[str, Any]:
    gaps = [gap.as_record() for gap in topic.timing.gaps[:MOST_GAPS]]
    record = {**topic.as_record(), "frame_id": frame_id}
    return {**_short(record), "gaps": gaps, "gaps_total": len(topic.timing.gaps)}


def _clocks(inspection: Inspection) -> dict[str, Any]:
    lag = inspection.clocks.imu_lag
    return {
        "topics": [_short(clock.as_record()) for clock in inspection.clocks.topics[:MOST_TOPICS]],
        "imu_lag": None if lag is None else _short(lag.as_record()),
    }


def _short(record: dict[str, Any]) -> dict[str, Any]:
    return {name: value[:LONGEST_TEXT] if isinstance(value, str) else value for name, value in record.items()}
