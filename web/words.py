"""Template filters and tests: values formatted for people.

**Conventions.** Unknown values are shown as a dash. Ratios are written in per cent, bytes in powers of 1000 as disks
are sold, durations in the two largest units.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime, tzinfo
from typing import Any

from fastapi import Request
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.jobs.queries import title_of
from services.runtime.orm import Benchmark, Phase, Team
from stone.labels.class_colours import PALETTES, ColourName
from stone_base.codes.catalogue import harm_rank
from stone_base.counts import counted
from web.zones import written

# The word of every state that a page shows: one key, one word, everywhere.
#
# **Conventions.** Keys are the values of the API and the database, which never change for a word's sake; `data-state`
# of an element is the key, its text the word. A key that is missing here is shown as it is written.


STATE_WORDS: Mapping[str, str] = {
    # jobs, runs, attempts, exports, comparisons, imports
    "queued": "queued",
    "running": "running",
    "succeeded": "succeeded",
    "failed": "failed",
    "cancelled": "cancelled",
    "lost": "lost",
    "waiting": "waiting",
    # sequences and their recordings
    "empty": "no recording",
    "uploading": "upload unfinished",
    "reading": "reading",
    "recorded": "not labelled",
    "processing": "processing",
    "labelled": "labelled",
    "received": "reading",
    "registered": "registered",
    "refused": "refused",
    # submissions
    "draft": "draft",
    "scoring": "scoring",
    "scored": "scored",
    "valid": "valid",
    "invalid": "invalid",
    "withdrawn": "withdrawn",
    "hidden": "hidden",
    # ground truths, inputs, playbacks, re-scores
    "none": "none",
    "making": "being made",
    "ready": "ready",
    "missing": "missing",
    "active": "active",
    "incomplete": "incomplete",
    "complete": "complete",
    "activated": "activated",
    "abandoned": "abandoned",
    # phases
    "upcoming": "upcoming",
    "open": "open",
    "closed": "closed",
    # queues and workers
    "paused": "paused",
    "draining": "draining",
    "busy": "busy",
    "idle": "idle",
    "silent": "silent",
    # deliveries of notifications
    "delivered": "delivered",
    "dropped": "dropped",
    "dead": "given up",
    # users, webhooks, addresses, tokens
    "deactivated": "deactivated",
    "disabled": "disabled",
    "failing": "failing",
    "verified": "verified",
    "unverified": "not verified",
    "expired": "expired",
}


def state_word(state: str) -> str:
    """Return the word of the state."""
    return STATE_WORDS.get(state, state.replace("_", " "))


STAGE_WORDS: Mapping[str, str] = {
    "check": "checking",
    "compare": "comparing",
    "copy": "copying",
    "fetch": "downloading",
    "index": "reading tables",
    "inspect": "reading",
    "keep": "saving",
    "labels": "labelling",
    "map": "drawing the map",
    "measure": "measuring",
    "part": "counting",
    "publish": "saving",
    "score": "scoring",
    "store": "saving",
    "synchronise": "synchronising",
    "truth": "packing the ground truth",
}
"""The words of the steps within a job."""


def stage_word(stage: str) -> str:
    """Return the title of a stage of a run, or the word of a step within a job."""
    return STAGE_WORDS.get(stage) or title_of(stage)


# The reader's class colours, from the switch in the footer of every page.
#
# **Conventions.** The cookie holds a palette's name of `stone/labels/class_colours.py`; anything else counts as the
# default. A cookie, so that the server draws the first picture right; none of an account, since visitors have none.


COOKIE = "stone_colours"


def colours_of(request: Request) -> ColourName:
    """Return the palette of class colours."""
    chosen = request.cookies.get(COOKIE, "")
    return next((name for name in PALETTES if name == chosen), "default")


def coloured(url: str, colours: ColourName) -> str:
    """Return the URL of a picture of labels in this palette."""
    if colours == "default":
        return url
    return f"{url}{'&' if '?' in url else '?'}colours={colours}"


DASH = "–"
UNITS = ("B", "kB", "MB", "GB", "TB", "PB")
SPANS = (("d", 86_400), ("h", 3600), ("min", 60), ("s", 1))


def size(n_bytes: float | None) -> str:
    """Return a size as `2.5 GB`."""
    if n_bytes is None:
        return DASH
    value, unit = float(n_bytes), 0
    while abs(value) >= 999.5 and unit < len(UNITS) - 1:
        value, unit = value / 1000, unit + 1
    return f"{value:.0f} {UNITS[unit]}" if unit == 0 or value >= 99.5 else f"{value:.1f} {UNITS[unit]}"


def span(seconds: float | None) -> str:
    """Return a duration as `2 h 5 min`; below ten seconds with a decimal."""
    if seconds is None:
        return DASH
    if seconds < 10:
        return f"{seconds:.1f} s"
    left, parts = round(seconds), list[str]()
    for name, length in SPANS:
        count, rest = divmod(left, length)
        if count or parts:
            parts.append(f"{count} {name}" if count else "")
            left = rest
        if len(parts) == 2:
            break
    return " ".join(part for part in parts if part)


def about(seconds: float | None) -> str:
    """Return a rounded estimate as `about 40 s`, `about 2 min`."""
    return "not known yet" if seconds is None else f"about {span(seconds).replace('.0 s', ' s')}"


def distance(metres: float | None) -> str:
    """Return a distance as `1.82 km`; below a kilometre in metres."""
    if metres is None:
        return DASH
    return f"{metres:.0f} m" if metres < 999.5 else f"{metres / 1000:.2f} km"


def percent(ratio: float | None, digits: int = 1) -> str:
    """Return a ratio as `29.1 %`."""
    return DASH if ratio is None else f"{100 * ratio:.{digits}f} %"


def number(value: float | None) -> str:
    """Return a number as `12,345`."""
    if value is None:
        return DASH
    return f"{value:,}" if isinstance(value, int) else f"{value:,.2f}"


def moment(value: datetime | None, zone: tzinfo, is_exact: bool = False) -> str:
    """Return the time in the reader's zone."""
    return DASH if value is None else written(value, zone, is_exact=is_exact)


def iso(value: datetime) -> str:
    """Return the time as `datetime` of a `<time>`."""
    return value.isoformat().replace("+00:00", "Z")


def spoken(code: str) -> str:
    """Return a code as words: `worker_lost` → `worker lost`."""
    return code.replace("_", " ")


def short(identity: str | None) -> str:
    """Return the end of an id, which differs between objects created in sequence."""
    return DASH if not identity else identity[-8:]


def by_harm(findings: Iterable[Any]) -> list[Any]:
    """Sort findings, mappings or values by harm to labels, the worst first; equal harm keeps the order."""

    def rank(one: Any) -> tuple[int, int]:
        code, severity = (one["code"], one["severity"]) if isinstance(one, Mapping) else (one.code, one.severity)
        return harm_rank(code, severity)

    return sorted(findings, key=rank)


def sentence_of(finding: Any) -> str:
    """Return the sentence of a finding, a mapping or a value, after its topic unless the sentence contains it."""
    named = finding if isinstance(finding, Mapping) else {"topic": finding.topic, "message": finding.message}
    topic, message = str(named.get("topic") or ""), str(named["message"])
    return f"{topic}: {message}" if topic and topic not in message else message


FILTERS: Mapping[str, Callable[..., Any]] = {
    "sentence_of": sentence_of,
    "size": size,
    "span": span,
    "about": about,
    "percent": percent,
    "distance": distance,
    "number": number,
    "moment": moment,
    "iso": iso,
    "spoken": spoken,
    "short": short,
    "state_word": state_word,
    "job_title": title_of,
    "stage_word": stage_word,
    "by_harm": by_harm,
    "coloured": coloured,
    "counted": counted,
}
TESTS: Mapping[str, Callable[..., bool]] = {}


@dataclass(frozen=True)
class PhaseName:
    """The name of a phase, and the URL of its pages."""

    benchmark: str
    title: str
    phase: str

    @property
    def path(self) -> str:
        return f"/benchmarks/{self.benchmark}/{self.phase}"

    @property
    def said(self) -> str:
        return f"{self.title or self.benchmark} · {self.phase}"


def phase_names(session: Session, ids: Iterable[str]) -> Mapping[str, PhaseName]:
    """Return phase names by the phase's id, by one statement."""
    joined = select(Phase.id, Benchmark.name, Benchmark.title, Phase.name).join(
        Benchmark, Benchmark.id == Phase.benchmark_id
    )
    rows = session.execute(joined.where(Phase.id.in_(set(ids))))
    return {phase_id: PhaseName(benchmark, title, phase) for phase_id, benchmark, title, phase in rows}


def team_names(session: Session, ids: Iterable[str]) -> Mapping[str, str]:
    """Return team names by the team's id, by one statement."""
    named = select(Team.id, Team.name).where(Team.id.in_(set(ids)))
    return {team_id: name for team_id, name in session.execute(named)}
