"""What is kept of an inspection in a row: the same record as `stone inspect --json`, bounded.

**Conventions.** A hostile recording may declare a hundred thousand topics with endless names; what is cut is counted.
"""

from typing import Any

from services.ingest.inspection import InspectedTopic, Inspection

MOST_TOPICS, MOST_GAPS, MOST_FINDINGS = 300, 20, 200
LONGEST_TEXT = 300


def inspection_record(inspection: Inspection) -> dict[str, Any]:
    """`duration_ns`, `topics`, `findings` and how many of the last two there were."""
    return {
        "duration_ns": inspection.duration_ns,
        "topics": [_topic(topic) for topic in inspection.topics[:MOST_TOPICS]],
        "topics_total": len(inspection.topics),
        "findings": [_short(finding.as_record()) for finding in inspection.findings[:MOST_FINDINGS]],
        "findings_total": len(inspection.findings),
    }


def _topic(topic: InspectedTopic) -> dict[str, Any]:
    gaps = [gap.as_record() for gap in topic.timing.gaps[:MOST_GAPS]]
    return {**_short(topic.as_record()), "gaps": gaps, "gaps_total": len(topic.timing.gaps)}


def _short(record: dict[str, Any]) -> dict[str, Any]:
    return {name: value[:LONGEST_TEXT] if isinstance(value, str) else value for name, value in record.items()}
