"""A world whose hidden phase runs, with entries in it; who asks there, what must not be told, and how to change that.

**Conventions.** Counts of hidden voxels are planted so large that no sum hides them. Two teams are scored in both
phases; one also sent what is refused and what is only checked. A hidden sequence's labels have been exported and
compared by their owner.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import select, text
from sqlalchemy.orm import Session

from services.runtime.orm import (
    Artefact,
    Blob,
    Dataset,
    DatasetMember,
    Export,
    GroundTruthRow,
    Job,
    LabelComparison,
    LabelledFrameRow,
    LabelSet,
    Score,
    SequenceRow,
    SubmissionRow,
    Team,
    Upload,
    User,
)  # fmt: skip
from stone.scoring.metric import METRICS
from stone.splits.splits import PARTS
from testing.api.serving import Person, person
from testing.worlds import made, published
from testing.worlds.benchmark_world import World, predicted, run_eval
from testing.worlds.sending import send, standing_world, zipped
from tests.api.hidden_things import Secrets, secrets_of

FRAMES = 1
STRANGER = "f" * 32
EXPORTED = "gts/labels.npz"
BIG = 7_000_000_000_000


@dataclass(frozen=True, eq=False)
class Stage:
    """The world while its hidden phase runs, who asks, and what must not be told."""

    world: World
    callers: Mapping[str, Person]
    secrets: Secrets


@contextmanager
def staged(folder: Path, template: Path) -> Iterator[Stage]:
    """The stage; a few seconds."""
    with standing_world(folder, template, FRAMES) as world:
        _count_loudly(world)
        _export(world)
        _compare(world)
        _submit(world)
        callers = {"a captain": world.captains[0], "a stranger": person(world.platform, "participant")}
        with world.platform.database.reading() as session:
            secrets = secrets_of(session, world)
        yield Stage(world, callers, secrets)


def known(world: World) -> dict[str, list[str]]:
    """Whatever exists, whosever it is, by the name of the parameter that may hold it."""
    with world.platform.database.reading() as session:

        def ids(table: Any) -> list[str]:
            return list(session.scalars(select(table.id).order_by(table.id)))

        sequences = session.execute(select(SequenceRow.id, SequenceRow.name).order_by(SequenceRow.id)).all()
        datasets = list(session.scalars(select(Dataset.name).order_by(Dataset.id.desc()).limit(1)))
        scored = _one_of_each_phase(session, SubmissionRow)
        known = {"sequence_id": [row.id for row in sequences], "sequence_name": [row.name for row in sequences]}
        known |= {
            "submission_id": ids(SubmissionRow),
            "score": _one_of_each_phase(session, Score),
            "job_id": ids(Job),
            "team_id": ids(Team),
        }
        sets = ids(LabelSet)[-1:]
        known |= {"upload_id": ids(Upload), "export_id": ids(Export), "user_id": ids(User), "a": scored, "b": scored}
        known |= {"comparison_id": ids(LabelComparison), "label_set_id": sets}
    known |= {"phase_id": [world.val, world.test], "phase_name": ["val", "test"], "benchmark_name": [world.benchmark]}
    known |= {"dataset_name": datasets, "dataset": datasets, "part": ["train", "val", "test"]}
    known |= {"token": [*world.truth("val"), *world.truth("test")], "metric": list(METRICS), "code": ["not_found"]}
    known |= {"name": ["bev.png"], "path": [EXPORTED], "platform_name": ["robot"]}
    known |= {"tile_name": ["0_-1"], "channel": ["CAM_FRONT"], "v": sets}
    known |= {one: [STRANGER] for one in ("calibration_id", "recording_id", "rescore_id", "import_id")}
    return known | {one: ["meadow", "quarry"] for one in ("environment", "illumination", "region")}


def hidden_label_sets(session: Session, world: World) -> list[LabelSet]:
    of_names = select(LabelSet).join(SequenceRow, SequenceRow.id == LabelSet.sequence_id).order_by(SequenceRow.name)
    return list(session.scalars(of_names.where(SequenceRow.name.in_(world.grids["test"]))))


def hidden_scores(session: Session, world: World) -> list[Score]:
    return list(session.scalars(select(Score).join(SubmissionRow).where(SubmissionRow.phase_id == world.test)))


def change_what_is_hidden(session: Session, world: World) -> None:
    """Other labels, other counts, other scores that are rounded alike, other kept blobs; guards are put aside."""
    for guard in session.scalars(text("SELECT name FROM sqlite_master WHERE type = 'trigger' AND tbl_name = 'scores'")):
        session.execute(text(f"DROP TRIGGER {guard}"))
    label_sets = hidden_label_sets(session, world)
    other = session.scalars(select(Blob.sha256).order_by(Blob.size_bytes)).first() or ""
    for row in label_sets:
        row.free_voxels, row.t_voxels, row.p_voxels, row.n_voxels = 1, 2, 3, 4
        row.held_out_recall, row.held_out_m, row.gravest_code, row.gravest_severity = 0.1, 5.0, "TIM-201", "error"
    ids = [row.id for row in label_sets]
    for frame in session.scalars(select(LabelledFrameRow).where(LabelledFrameRow.label_set_id.in_(ids))):
        frame.sha256, frame.length_bytes = "0" * 64, frame.length_bytes - 1
    for artefact in session.scalars(select(Artefact).where(Artefact.label_set_id.in_(ids))):
        artefact.blob_sha256, artefact.size_bytes = other, 1
    for truth in session.scalars(select(GroundTruthRow).where(GroundTruthRow.phase_id == world.test)):
        truth.pack_sha256 = other
    for score in hidden_scores(session, world):
        score.confusions_sha256, score.content_sha256 = other, "0" * 64
        score.record = {**_changed(score.record), "frames": score.record["frames"], "total": _rounded(score)}


def _count_loudly(world: World) -> None:
    """Counts of hidden voxels that nothing else is, also not added to others; and a version that was made of them."""
    with world.platform.database.transaction() as session:
        for number, row in enumerate(hidden_label_sets(session, world)):
            row.t_voxels, row.p_voxels, row.n_voxels = BIG + number, 2 * BIG + number, 3 * BIG + number
            row.held_out_m = 4 * BIG + number
    with world.platform.database.reading() as session:
        members = session.execute(select(DatasetMember.part, DatasetMember.sequence_id)).all()
    parts: dict[str, list[str]] = {part: [one.sequence_id for one in members if one.part == part] for part in PARTS}
    published.dataset(world.platform, world.administrator.user_id, parts)


def _export(world: World) -> None:
    """The labels of a hidden sequence have been exported by their owner, and are played to nobody else."""
    with world.platform.database.reading() as session:
        hidden = hidden_label_sets(session, world)[0].sequence_id
    made.export(world.platform, hidden, {EXPORTED: world.hidden_files[0]})
    made.playback(world.platform, hidden, list(world.truth("test")), world.hidden_files[0])


def _compare(world: World) -> None:
    """A comparison of a hidden sequence's labels, finished, whose record tells of them."""
    with world.platform.database.transaction() as session:
        a, b = hidden_label_sets(session, world)[:2]
        facts = {"sequence_id": a.sequence_id, "a_id": a.id, "b_id": b.id, "job_id": a.job_id, "code_version": "1"}
        session.add(LabelComparison(**facts, record={"frames": BIG + 11}, finished_ns=1))


def _submit(world: World) -> None:
    """Two teams are scored in both phases; one also sends what is refused and what is only checked."""
    for part in ("val", "test"):
        for team in (0, 1):
            frames = predicted(_without_canary(world, part), 0.3, seed=100 * team)
            send(world, zipped(world, frames), part, team=team)
    frames = predicted(_without_canary(world, "test"), 0.5, seed=7)
    send(world, zipped(world, frames), "test", kind="validation")
    spoilt = {token: grid + (grid == 2) * np.uint8(100) for token, grid in frames.items()}
    send(world, zipped(world, spoilt), "test")
    run_eval(world.platform)
    with world.platform.database.reading() as session:
        states = sorted(session.scalars(select(SubmissionRow.state)))
    assert states == ["invalid", "scored", "scored", "scored", "scored", "valid"]


def _without_canary(world: World, part: str) -> dict[str, Any]:
    """The grids that are predicted from: who knew the canary could be told it."""
    grids = {token: grid.copy() for token, grid in world.truth(part).items()}
    for grid in grids.values():
        grid[:16, :16] = 0
    return grids


def _one_of_each_phase(session: Session, table: type[SubmissionRow] | type[Score]) -> list[str]:
    """Of the first team: more of them are asked for by the routes that list them."""
    scores = select(table.id, SubmissionRow.phase_id).where(SubmissionRow.state == "scored").order_by(table.id)
    if table is Score:
        scores = scores.join(SubmissionRow, SubmissionRow.id == Score.submission_id)
    return list({phase: found for found, phase in session.execute(scores)}.values())


def _rounded(score: Score) -> dict[str, float | None]:
    """The totals, each changed to what it is rounded to, in the columns too."""
    found = {name: None if value is None else round(value, 4) for name, value in score.record["total"].items()}
    for name, value in found.items():
        assert value != score.record["total"][name] or value is None
        setattr(score, name, value)
    return found


def _changed(record: Any) -> Any:
    """Every number another."""
    if isinstance(record, dict):
        return {name: _changed(one) for name, one in record.items()}
    if isinstance(record, list):
        return [_changed(one) for one in record]
    if isinstance(record, bool) or not isinstance(record, int | float):
        return record
    return record + 1 if isinstance(record, int) else 1.0 - record
