"""The visibility policy of a phase in sentences, generated from the table that the queries apply.

**Conventions.** Who sees a field in one state of the phase is read off `visibility.TABLE`, so that words and deeds
cannot part.
"""

from collections.abc import Iterator

from services.domain.benchmarks.visibility import RATIO_DIGITS, TABLE, Field, Relation, Secrecy, secrecy_of
from services.runtime.orm import Phase

WORDS: dict[Field, str] = {
    "totals": f"totals rounded to {RATIO_DIGITS} digits",
    "exact": "exact totals",
    "intervals": "intervals",
    "ranks": "intervals of ranks and ties",
    "comparison": "paired comparisons",
    "breakdowns": "results by sequence, environment, illumination and distance",
    "extras": "additional metrics and supports",
    "confusions": "confusion counts per frame",
    "content": "equality of predictions",
    "provenance": "provenance of scores",
    "method": "methods and modalities",
    "description": "method descriptions",
    "team": "teams",
    "file": "size and sha256 of files",
    "state": "progress of submissions",
    "problems": "problems of files",
    "reason": "reasons for hiding entries",
    "frames": "pictures of frames beside the ground truth",
    "predictions": "zips of entries",
    "baseline": "zips of baselines",
}
VIEWERS: dict[tuple[Relation, ...], str] = {
    ("administrator", "member", "other"): "everyone",
    ("administrator", "member"): "the team and administrators",
    ("administrator",): "administrators only",
    (): "nobody",
}
WHEN: dict[Secrecy, str] = {
    "open": "The ground truth is open",
    "running": "The ground truth is hidden and the phase has not ended",
    "ended": "The ground truth is hidden and the phase has ended",
}


def policy_sentences(phase: Phase, at_ns: int) -> tuple[str, ...]:
    """The visibility policy at this time in sentences; of a hidden phase with an end also what will be shown."""
    now = secrecy_of(phase, at_ns)
    later: tuple[Secrecy, ...] = ("ended",) if now == "running" and phase.closes_ns is not None else ()
    named = phase.named_from_ns is not None and at_ns < phase.named_from_ns
    hidden_names = ("Until named_from_at, only members and administrators see teams and method descriptions.",)
    return (*(_sentence(state) for state in (now, *later)), *(hidden_names if named else ()))


def _sentence(state: Secrecy) -> str:
    return f"{WHEN[state]}: {'; '.join(_shares(state))}."


def _shares(state: Secrecy) -> Iterator[str]:
    for viewers, words in VIEWERS.items():
        seen = [WORDS[name] for name, table in TABLE.items() if table[state] == viewers]
        if seen:
            yield f"{words}: {', '.join(seen)}"
