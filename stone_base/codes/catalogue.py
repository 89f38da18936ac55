"""All codes that have a meaning here: those of findings, of failed runs and of warnings about a phase.

**Conventions.** Codes of published datasets (`DST-…`), of submissions and of the API are not findings and not in here.
"""

from collections.abc import Mapping

from stone_base.codes import calibrations, clocks, containers, failures, labels, messages, poses
from stone_base.codes.meaning import HARM_ORDER, CodeMeaning, Harm

_MODULES = (containers, messages, clocks, poses, calibrations, labels, failures)
CATALOGUE: Mapping[str, CodeMeaning] = {
    one.code: one for one in sorted((one for module in _MODULES for one in module.MEANINGS), key=lambda one: one.code)
}
PROFILE_CODES = frozenset({"LAB-601", "LAB-603", "LAB-606", "LAB-613", "LAB-614"})
"""Codes of labels made with profile `paper` that processing again with profile `field` solves."""
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
"""Titles of the families of codes, in the order in which they are listed; "" is of codes in small letters."""


def harm_of(code: str, severity: str) -> Harm | None:
    """What a finding does to the labels; None for a code that is not in the catalogue."""
    meaning = CATALOGUE.get(code)
    return None if meaning is None else meaning.harm_as(severity)


def harm_rank(code: str, severity: str) -> tuple[int, int]:
    """A sort key: most harm first, errors before warnings; a code that is not in the catalogue goes by severity."""
    harm = harm_of(code, severity) or {"error": "refused", "warning": "wrong"}.get(severity, "none")
    grade = {"error": 0, "warning": 1}.get(severity, 2)
    return (HARM_ORDER.index(harm), grade)


def by_family() -> Mapping[str, tuple[CodeMeaning, ...]]:
    """The catalogue by title of family."""
    return {
        title: tuple(one for one in CATALOGUE.values() if (one.code[:3] if one.code[:1].isupper() else "") == family)
        for family, title in FAMILIES.items()
    }
