"""The quality of a recording as one HTML file that needs nothing beside it: no script, no font, no link outwards.

**Conventions.** Everything a recording said is escaped (`markup`), and the page forbids itself to load or run anything
(its Content-Security-Policy), so a name that slipped through would still be dead text. Equal inputs, equal bytes.
"""

from collections.abc import Sequence
from datetime import UTC, datetime

from services.ingest.cdr import NS_PER_S
from services.ingest.inspection import Inspection
from services.ingest.quality.markup import LONGEST_NAME, number, text
from services.ingest.quality.report import Quality
from services.ingest.quality.section_clocks import clocks_section
from services.ingest.quality.section_overview import (
    Picture,
    findings_section,
    lost_section,
    pictures_section,
    ring,
)
from services.ingest.quality.section_sensors import cameras_section, clouds_section, rtk_section
from services.ingest.quality.section_time import coverage_section, rates_section
from services.ingest.quality.style import STYLE

POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'"
TITLES = {
    "lost": "Score", "pictures": "Pictures", "findings": "Findings", "coverage": "Coverage", "rates": "Rates",
    "clocks": "Clocks", "rtk": "Position", "cameras": "Cameras", "clouds": "LiDAR, radar",
}  # fmt: skip
LAST_YEAR_NS = 253_370_764_800 * NS_PER_S


def quality_page(name: str, inspection: Inspection, quality: Quality, pictures: Sequence[Picture] = ()) -> bytes:
    """The page of the recording called `name`, UTF-8; `pictures` are previews to show (name, media type, bytes)."""
    facts, span_ns = quality.facts, inspection.duration_ns
    sections = {
        "lost": lost_section(quality),
        "pictures": pictures_section(pictures),
        "findings": findings_section((*inspection.findings, *quality.left_out)),
        "coverage": coverage_section(facts.coverage, len(inspection.topics), span_ns),
        "rates": rates_section(facts.coverage, span_ns),
        "clocks": clocks_section(inspection.clocks),
        "rtk": rtk_section(facts.rtk, span_ns),
        "cameras": cameras_section(facts.cameras, span_ns),
        "clouds": clouds_section(facts.lidars, facts.radars, span_ns),
    }
    shown = {anchor: content for anchor, content in sections.items() if content}
    links = "".join(f'<li><a href="#{anchor}">{TITLES[anchor]}</a></li>' for anchor in shown)
    return (
        f"{_head(name)}<body>"
        f'<a class="skip" href="#lost">Skip to the report</a>{_header(name, inspection, quality)}'
        f'<nav aria-label="Parts of the report"><ul>{links}</ul></nav><main>{"".join(shown.values())}</main>'
        f"{_footer()}</body></html>\n"
    ).encode()


def _head(name: str) -> str:
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Quality of {text(name, LONGEST_NAME)}</title><style>{STYLE}</style></head>"
    )


def _header(name: str, inspection: Inspection, quality: Quality) -> str:
    messages = sum(topic.topic.count for topic in inspection.topics)
    facts = [f"{number(inspection.duration_ns / NS_PER_S)} s", f"{len(inspection.topics)} topics"]
    facts.append(f"{number(messages, 0)} messages")
    if begun := _date(quality.facts.start_ns):
        facts.append(f"begun {begun}")
    words = f'<h1><bdi>{text(name, LONGEST_NAME)}</bdi></h1><p class="soft">{" · ".join(facts)}</p>'
    return f'<header><div class="words">{words}</div>{ring(quality.score)}</header>'


def _footer() -> str:
    return (
        '<footer class="soft"><p>Coverage, rates and clocks are of every message. Pictures, clouds, scans and position '
        "solutions are of about 1 % of them, evenly spread. Times are the recorder's.</p></footer>"
    )


def _date(stamp_ns: int) -> str:
    """Nothing where the recorder's clock was never set."""
    if not NS_PER_S < stamp_ns < LAST_YEAR_NS:
        return ""
    return datetime.fromtimestamp(stamp_ns // NS_PER_S, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
