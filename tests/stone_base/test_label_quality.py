"""The quality of labels: what is read from a report, and of several label sets together."""

from typing import Any

import pytest

from stone_base.codes.catalogue import CATALOGUE
from stone_base.codes.meaning import CodeMeaning, Harm
from stone_base.label_quality import UNKNOWN, LabelQuality, pooled, quality_of


@pytest.fixture(autouse=True)
def codes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four codes, each of its own harm."""
    harms: dict[str, Harm] = {"A-1": "none", "A-2": "less", "A-3": "wrong", "A-4": "wrong"}
    meanings = {code: CodeMeaning(code, harm, "", "") for code, harm in harms.items()}
    for code, meaning in meanings.items():
        monkeypatch.setitem(CATALOGUE, code, meaning)  # type: ignore[arg-type]


def report(*findings: str, **more: Any) -> dict[str, Any]:
    """A report with these findings, each as `code severity`."""
    listed = [dict(zip(("code", "severity"), one.split(), strict=True)) for one in findings]
    return {"findings": [{**one, "topic": "", "message": "so"} for one in listed], **more}


@pytest.mark.parametrize(
    ("findings", "gravest"),
    [
        ((), None),
        (("A-1 error", "A-9 error"), None),
        (("A-3 info",), None),
        (("A-2 error", "A-1 warning"), {"code": "A-2", "harm": "less"}),
        (("A-2 error", "A-4 warning", "A-3 warning"), {"code": "A-4", "harm": "wrong"}),
        (("A-4 warning", "A-3 error"), {"code": "A-3", "harm": "wrong"}),
    ],
)
def test_the_gravest_finding_is_that_which_harms_labels_most(findings: tuple[str, ...], gravest: object) -> None:
    assert quality_of(report(*findings)).as_record()["gravest"] == gravest


def test_a_recall_is_read_with_its_metres_and_unknown_in_reports_without_one() -> None:
    known = quality_of(report(held_out={"recall": 0.9, "judged_m": 12.0}))
    assert (known.held_out_recall, known.held_out_m) == (0.9, 12.0)
    assert quality_of(report(held_out={"recall": None, "judged_m": 0.0})) == UNKNOWN
    assert quality_of({}) == UNKNOWN


def test_the_recall_of_several_label_sets_is_that_of_their_metres() -> None:
    sets = [LabelQuality(0.9, 30.0, "A-2", "warning"), UNKNOWN, LabelQuality(0.5, 10.0, "A-3", "warning")]
    assert pooled(sets) == LabelQuality((27 + 5) / 40, 40.0, "A-3", "warning")
    assert pooled([UNKNOWN]) == pooled([]) == UNKNOWN
