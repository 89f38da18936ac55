"""The quality of a label set in two figures: its held-out track, and the finding that harms its labels most.

**Conventions.** Both are read from the set's `report.json`. None is unknown: labels that were imported or made by an
earlier version, or a way too short to be judged.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from stone_base.codes.catalogue import harm_of, harm_rank
from stone_base.codes.meaning import Harm


@dataclass(frozen=True)
class GravestFinding:
    """The code of a finding, and how it harms the labels."""

    code: str
    harm: Harm


@dataclass(frozen=True)
class LabelQuality:
    """`held_out_recall` is the share of ground, driven over in the half of the way that a reference did not see, that
    its labels call T or P; `held_out_m` metres of way were judged. A gravest code of None: no finding harms the labels,
    or none is known."""

    held_out_recall: float | None = None
    held_out_m: float | None = None
    gravest_code: str | None = None
    gravest_severity: str | None = None

    @property
    def gravest(self) -> GravestFinding | None:
        """None as well for a code that the catalogue lacks, or that does no harm."""
        if self.gravest_code is None or self.gravest_severity is None:
            return None
        harm = harm_of(self.gravest_code, self.gravest_severity)
        return None if harm is None or harm == "none" else GravestFinding(self.gravest_code, harm)

    def as_record(self) -> dict[str, Any]:
        """The figures as answers, manifests and exports contain them."""
        gravest = self.gravest
        return {
            "held_out_recall": self.held_out_recall,
            "held_out_m": self.held_out_m,
            "gravest": None if gravest is None else {"code": gravest.code, "harm": gravest.harm},
        }


UNKNOWN = LabelQuality()


def quality_of(report: Mapping[str, Any]) -> LabelQuality:
    """Return the quality that a `report.json` states; an older report, or that of imported labels, lacks a part."""
    held = report.get("held_out") or {}
    recall = held.get("recall")
    found = (LabelQuality(None, None, one["code"], one["severity"]) for one in report.get("findings") or ())
    judged_m = None if recall is None else held.get("judged_m")
    return replace(gravest_of(found), held_out_recall=recall, held_out_m=judged_m)


def gravest_of(qualities: Iterable[LabelQuality]) -> LabelQuality:
    """Return the finding that harms labels most, the first of equal ones, as a quality without a recall."""
    harmed = [
        (one.gravest_code, one.gravest_severity)
        for one in qualities
        if one.gravest_code and one.gravest_severity and one.gravest
    ]
    if not harmed:
        return UNKNOWN
    code, severity = min(harmed, key=lambda one: harm_rank(*one))
    return LabelQuality(gravest_code=code, gravest_severity=severity)


def pooled(qualities: Iterable[LabelQuality]) -> LabelQuality:
    """Return the recall over the judged metres of all label sets together, and the gravest finding of any."""
    rows = list(qualities)
    judged = [(one.held_out_recall, one.held_out_m) for one in rows]
    known = [(recall, judged_m) for recall, judged_m in judged if recall is not None and judged_m]
    total_m = sum(judged_m for _, judged_m in known)
    if not total_m:
        return gravest_of(rows)
    recall = sum(recall * judged_m for recall, judged_m in known) / total_m
    return replace(gravest_of(rows), held_out_recall=round(recall, 4), held_out_m=round(total_m, 1))
