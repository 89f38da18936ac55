"""Published rows behind the golden lists: versions of the dataset, exports, and submissions with their phase."""

from typing import Any

from sqlalchemy import insert
from sqlalchemy.orm import Session

from services.runtime.orm import Benchmark, Dataset, DatasetMember, Export, Phase, SubmissionRow, Team, TeamMember
from tests.api.listed.listed_values import EPOCH_NS, SHA, at_ns, id_of


def add_versions(session: Session) -> None:
    """Two, of which the second has the public sequence of Bob in test: it is shown to nobody but him."""
    rows = [
        {
            "id": id_of("dataset", number), "name": f"stone-{number}.0", "licence": "CC-BY-4.0" if number == 1 else "",
            "code_version": "0.1.0", "manifest_sha256": SHA, "manifest_bytes": 100 * number,
            "created_by": id_of("user", 3), "created_ns": at_ns(number),
        }
        for number in (1, 2)
    ]  # fmt: skip
    session.execute(insert(Dataset), rows)
    members = [_member(1, 1, "train"), _member(1, 3, "val"), _member(2, 6, "test"), _member(2, 1, "train")]
    session.execute(insert(DatasetMember), members)


def _member(dataset: int, sequence: int, part: str) -> dict[str, Any]:
    named = {"dataset_id": id_of("dataset", dataset), "sequence_id": id_of("sequence", sequence), "part": part}
    said = {"label_set_id": id_of("labels", 1), "name": f"forest-{sequence}", "environment": "", "illumination": ""}
    return named | said | {"region": "", "recipe": SHA, "frames": 10, "duration_ns": 10**9}


def add_exports(session: Session) -> None:
    """Of Ada's first sequence: one that is done and stale, one whose job failed."""
    rows = []
    for number, (labels, job, finished) in enumerate(((2, 90, True), (1, 20, False), (4, 93, False)), 1):
        rows.append(
            {
                "id": id_of("export", number), "sequence_id": id_of("sequence", 6 if number == 3 else 1),
                "label_set_id": id_of("labels", labels), "job_id": id_of("job", job), "format": "nuscenes",
                "recipe": f"{number:064x}", "code_version": "0.1.0", "created_ns": at_ns(number),
                "finished_ns": at_ns(number + 1) if finished else None, "files": 12 if finished else 0,
                "size_bytes": 1200 if finished else 0, "tar_bytes": 1536 if finished else 0,
                "tar_sha256": SHA if finished else "", "zip_bytes": 1400 if finished else 0,
                "zip_sha256": SHA if finished else "",
            }
        )  # fmt: skip
    session.execute(insert(Export), rows)


def add_submissions(session: Session) -> None:
    """Ada's team's: a draft, one that is refused, one that waits, one that is scored, one that is hidden."""
    team = id_of("team", 1)
    session.execute(insert(Team), [{"id": team, "name": "crows", "created_ns": EPOCH_NS}])
    session.execute(insert(TeamMember), [{"team_id": team, "user_id": id_of("user", 1), "is_owner": True}])
    of = {"created_by": id_of("user", 3), "created_ns": EPOCH_NS, "is_public": True}
    session.execute(
        insert(Benchmark), [{"id": id_of("team", 2), "name": "terrain", "title": "", "description": ""} | of]
    )
    phase = {"id": id_of("team", 3), "benchmark_id": id_of("team", 2), "name": "val", "dataset_id": id_of("dataset", 1)}
    session.execute(insert(Phase), [phase | {"part": "val", "is_hidden": False, "created_ns": EPOCH_NS}])
    rows = [
        _submission(number, state) for number, state in enumerate(("draft", "invalid", "queued", "scored", "valid"), 1)
    ]
    session.execute(insert(SubmissionRow), rows)


def _submission(number: int, state: str) -> dict[str, Any]:
    is_invalid, is_draft = state == "invalid", state == "draft"
    problems = {"errors_total": 2, "errors": [{"code": "bad_label", "sentence": "no label"}]} if is_invalid else None
    return {
        "id": id_of("submission", number), "phase_id": id_of("team", 3), "team_id": id_of("team", 1),
        "user_id": id_of("user", 1), "kind": "validation" if state == "valid" else "entry",
        "method": f"méthode {number}", "description": "what it is", "modality": "C+L", "state": state,
        "declared_sha256": SHA, "size_bytes": 10**12 + number,
        "job_id": id_of("job", 92) if state == "queued" else None, "problems": problems,
        "failure_code": "invalid_labels" if is_invalid else "", "failure": "two faults" if is_invalid else "",
        "revision": number, "created_ns": at_ns(number), "finalized_ns": None if is_draft else at_ns(number + 1),
        "settled_ns": at_ns(number + 2) if state in ("invalid", "scored", "valid") else None,
        "withdrawn_ns": at_ns(number + 3) if state == "valid" else None,
        "hidden_ns": at_ns(number + 4) if state == "scored" else None,
        "hidden_reason": "looked odd" if state == "scored" else "",
    }  # fmt: skip
