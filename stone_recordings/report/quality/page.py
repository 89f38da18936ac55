"""The quality of a recording as one self-contained HTML file: no script, no font, no outward link.

**Conventions.** `templates/page.html` draws it, and `templates/<anchor>.html` each section. All text from a recording
is escaped (`markup`), and the page's Content-Security-Policy forbids loading or running anything, so that unescaped
text would still be inert. Equal inputs give equal bytes.
"""

from collections.abc import Sequence
from datetime import UTC, datetime

from stone_recordings.messages.types.cdr import NS_PER_S
from stone_recordings.report.inspection import Inspection
from stone_recordings.report.quality.markup import LONGEST_NAME, number, rendered, text
from stone_recordings.report.quality.report import Quality
from stone_recordings.report.quality.score import FULL_SCORE
from stone_recordings.report.quality.section_clocks import clocks_section
from stone_recordings.report.quality.section_overview import (
    Picture,
    codes_section,
    ordered,
    pictures_section,
    verdict_of,
)
from stone_recordings.report.quality.section_sensors import cameras_section, clouds_section, rtk_section
from stone_recordings.report.quality.section_time import coverage_section, rates_section

# Titles by anchor: in the navigation and above the section.
TITLES = {
    "lost": ("Score", "Score deductions"),
    "pictures": ("Overview", "Overview"),
    "findings": ("Findings", "Findings"),
    "coverage": ("Coverage", "Topic coverage"),
    "rates": ("Rates", "Rates over time"),
    "clocks": ("Clocks", "Clocks"),
    "rtk": ("Position", "Position solution"),
    "cameras": ("Cameras", "Cameras"),
    "clouds": ("LiDAR, radar", "LiDAR and radar"),
    "codes": ("Codes", "What the codes mean"),
}
ALWAYS = ("lost", "findings")
MOST_FINDINGS = 200
LAST_YEAR_NS = 253_370_764_800 * NS_PER_S


def quality_page(name: str, inspection: Inspection, quality: Quality, pictures: Sequence[Picture] = ()) -> bytes:
    """Return the page of the recording called `name`, UTF-8; `pictures` are previews (name, media type, bytes)."""
    facts, span_ns = quality.facts, inspection.duration_ns
    findings = ordered((*inspection.findings, *quality.left_out))
    sections = {
        "lost": quality.deductions,
        "pictures": pictures_section(pictures),
        "findings": findings[:MOST_FINDINGS],
        "coverage": coverage_section(facts.coverage, len(inspection.topics), span_ns),
        "rates": rates_section(facts.coverage, span_ns),
        "clocks": clocks_section(inspection.clocks),
        "rtk": rtk_section(facts.rtk, span_ns),
        "cameras": cameras_section(facts.cameras, span_ns),
        "clouds": clouds_section(facts.lidars, facts.radars, span_ns),
        "codes": codes_section(findings[:MOST_FINDINGS], quality.deductions),
    }
    shown = [(anchor, *titles) for anchor, titles in TITLES.items() if anchor in ALWAYS or sections[anchor]]
    page = rendered(
        "page.html",
        title=text(name, LONGEST_NAME),
        facts=_facts(inspection, quality),
        score=quality.score,
        full_score=FULL_SCORE,
        verdict=verdict_of(quality.score),
        shown=shown,
        span_s=span_ns / NS_PER_S,
        findings_left_out=len(findings) - len(findings[:MOST_FINDINGS]),
        **sections,
    )
    return page.encode()


def _facts(inspection: Inspection, quality: Quality) -> list[str]:
    messages = sum(topic.topic.count for topic in inspection.topics)
    facts = [number(inspection.duration_ns / NS_PER_S) + " s", f"{len(inspection.topics)} topics"]
    facts.append(number(messages, 0) + " messages")
    if begun := _date(quality.facts.start_ns):
        facts.append(f"started {begun}")
    return facts


def _date(stamp_ns: int) -> str:
    """Return the date, or "" if the recorder's clock was never set."""
    if not NS_PER_S < stamp_ns < LAST_YEAR_NS:
        return ""
    return datetime.fromtimestamp(stamp_ns // NS_PER_S, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
