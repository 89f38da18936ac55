"""All documented codes: findings, failed runs and warnings about a phase.

**Conventions.** Codes of published datasets (`DST-…`), of submissions and of the API are not findings and not listed.
"""

from collections.abc import Mapping

from stone_base.codes import calibrations, clocks, containers, failures, labels, messages, poses
from stone_base.codes.meaning import HARM_ORDER, CodeMeaning, Harm

_MODULES = (containers, messages, clocks, poses, calibrations, labels, failures)
CATALOGUE: Mapping[str, CodeMeaning] = {
    meaning.code: meaning
    for meaning in sorted(
        (meaning for module in _MODULES for meaning in module.MEANINGS), key=lambda meaning: meaning.code
    )
}
PROFILE_CODES = frozenset({"LAB-601", "LAB-603", "LAB-606", "LAB-613", "LAB-614"})
"""Codes of labels made with profile `paper` that disappear when the run is processed again with profile `field`."""
FAMILIES: Mapping[str, str] = {
    "BAG": "Recording files",
    "MSG": "Messages",
    "TOP": "Topics",
    "TIM": "Stamps and clocks",
    "GNS": "GNSS",
    "SYN": "Poses and frames",
    "CAL": "Calibrations",
    "LAB": "Labels",
    "IMP": "Imported labels",
    "QLT": "Data quality",
    "": "Failed runs and phase warnings",
}
"""Titles of the code families, in display order; "" is the family of lower-case codes."""


def harm_of(code: str, severity: str) -> Harm | None:
    """Return the effect of a finding on labels, or None for a code outside the catalogue."""
    meaning = CATALOGUE.get(code)
    return None if meaning is None else meaning.harm_as(severity)


def harm_rank(code: str, severity: str) -> tuple[int, int]:
    """Return a sort key: most harm first, then errors before warnings. Codes outside the catalogue sort by severity."""
    harm = harm_of(code, severity) or {"error": "refused", "warning": "wrong"}.get(severity, "none")
    grade = {"error": 0, "warning": 1}.get(severity, 2)
    return (HARM_ORDER.index(harm), grade)


def by_family() -> Mapping[str, tuple[CodeMeaning, ...]]:
    """Return the catalogue's meanings by family title."""
    return {
        title: tuple(
            meaning
            for meaning in CATALOGUE.values()
            if (meaning.code[:3] if meaning.code[:1].isupper() else "") == family
        )
        for family, title in FAMILIES.items()
    }
