"""The quality of labels in answers of sandboxed children: impossible figures and unknown codes are not believed."""

import json

import pytest

from services.labeler.child_answers import PublicationAnswer
from services.runtime.sandbox.errors import SandboxCrashedError

COUNTS = {"duration_ns": 1, "distance_m": 1.0, "free_voxels": 1, "t_voxels": 1, "p_voxels": 1, "n_voxels": 1}
QUALITY = {"held_out_recall": 1.0, "held_out_m": 75.4, "gravest_code": "LAB-605", "gravest_severity": "warning"}


def answer(**quality: object) -> bytes:
    return json.dumps({"tokens": [], "stamps_ns": [], "packs": [], "totals": {**COUNTS, **QUALITY, **quality}}).encode()


def test_a_possible_quality_is_believed() -> None:
    totals = PublicationAnswer.believed(answer()).totals.model_dump()
    assert QUALITY.items() <= totals.items()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("held_out_recall", 1.01),
        ("held_out_recall", "1"),
        ("held_out_m", -1.0),
        ("gravest_code", "<script>"),
        ("gravest_code", "LAB-000"),
        ("gravest_severity", "grave"),
    ],
)
def test_an_impossible_quality_is_not_believed(name: str, value: object) -> None:
    with pytest.raises(SandboxCrashedError):
        PublicationAnswer.believed(answer(**{name: value}))
