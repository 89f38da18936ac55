"""Sequences as the API shows them, with their newest run and the active labels, by two statements for any number.

**Conventions.** Without a caller they are shown as to a visitor. Facts are a body as a dictionary in the order of its
schema; lists write them unchanged.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any

from sqlalchemy import BindParameter, Row, Select, func, select, true
from sqlalchemy.orm import Session

from api.deps import VISITOR, Caller
from api.errors import NotFoundError
from api.schemas.base import instant
from api.schemas.class_counts import ClassCounts
from api.schemas.sequences.sequences import ArtefactItem, LaterRecordingsItem, SequenceDetail, SequenceItem
from api.views.preview_files import previews_of_sequence
from api.visible import labels_of, sequences_shown
from services.domain.sequences.later_recordings import later_recordings
from services.domain.sequences.processing import PROCESS, REGISTER
from services.runtime.database.rows import KeptSelect, numbered, numbered_parameters, parameter, places_for
from services.runtime.orm import Artefact, Job, LabelSet, Recording, SequenceRow, SplitMember
from stone_base.label_quality import LabelQuality

UNLISTED = ("labels/", "scene/")
PICTURES = ("bev.png", "thumbnail.jpg", "thumbnail.png")  # JPEG in older label sets

SAID = (
    "id", "owner_id", "name", "environment", "illumination", "region", "platform", "is_public", "calibration_id"
)  # fmt: skip
NO_LABELS = {"labels": None, "class_voxels": None, "duration_s": None, "distance_m": None}
LABELS = (
    LabelSet.id, LabelSet.job_id, LabelSet.frames, LabelSet.code_version, LabelSet.created_ns, LabelSet.chosen_ns,
    LabelSet.held_out_recall, LabelSet.held_out_m, LabelSet.gravest_code, LabelSet.gravest_severity,
    LabelSet.duration_ns, LabelSet.distance_m, LabelSet.t_voxels, LabelSet.p_voxels, LabelSet.n_voxels,
)  # fmt: skip


def with_glances(page: Select[SequenceRow], owner: str | BindParameter[str] | None) -> Select[Any]:
    """Select the sequences of `page`, newest first, each with its newest run and the id of its active labels.

    Splits are selected for the sequences of `owner` only, for an administrator (None) for all. Other tables are looked
    up per row, because for joins a planner would read small tables whole.
    """
    shown = page.cte("shown")
    recordings = select(func.count()).select_from(Recording).where(Recording.sequence_id == shown.c.id)
    is_run = (Job.sequence_id == shown.c.id, Job.id == Job.root_id, Job.kind.in_((PROCESS, REGISTER)))
    runs = [select(column).where(*is_run).order_by(Job.id.desc()).limit(1) for column in (Job.id, Job.kind, Job.state)]
    chosen = select(LabelSet.id).where(LabelSet.sequence_id == shown.c.id)
    counting = chosen.order_by(LabelSet.chosen_ns.desc(), LabelSet.id.desc()).limit(1)
    is_told = true() if owner is None else shown.c.owner_id == owner
    split = select(SplitMember.part).where(SplitMember.sequence_id == shown.c.id, is_told)
    glances = [
        glance.scalar_subquery().label(f"glance_{index}") for index, glance in enumerate((recordings, *runs, split))
    ]
    labels = counting.scalar_subquery().label("labels_id")
    columns = [shown.c[name] for name in SAID]
    return select(*columns, *glances, labels, shown.c.revision, shown.c.created_ns).order_by(shown.c.id.desc())


def sequence_facts(session: Session, rows: Sequence[Row[Any]]) -> list[dict[str, Any]]:
    """Return the list items of rows of `with_glances`, each a `SequenceItem`; one statement reads their labels."""
    labels = _label_facts(session, [row.labels_id for row in rows if row.labels_id is not None])
    return [_facts(row, labels.get(row.labels_id, (NO_LABELS, None))) for row in rows]


def _facts(row: Sequence[Any], labels: tuple[dict[str, Any], str | None]) -> dict[str, Any]:
    # Unpacked at once: access by name would be a lookup per row.
    id, owner_id, name, environment, illumination, region, platform, is_public, calibration_id, *glances = row
    recordings, run_id, run_kind, run_state, split, _, revision, created_ns = glances
    return {
        "id": id,
        "owner_id": owner_id,
        "name": name,
        "environment": environment,
        "illumination": illumination,
        "region": region,
        "platform": platform,
        "is_public": bool(is_public),
        "calibration_id": calibration_id,
        "recordings": recordings,
        "job": None if run_id is None else {"id": run_id, "kind": run_kind, "state": run_state},
        **labels[0],
        "split": split,
        "picture": labels[1],
        "revision": revision,
        "created_at": instant(created_ns),
    }


def sequence_items(session: Session, sequences: Iterable[SequenceRow], caller: Caller = VISITOR) -> list[SequenceItem]:
    """Return sequences as a list shows them, in the given order."""
    session.flush()
    ids = [row.id for row in sequences]
    rows = _of_ids(caller.is_administrator, places_for(len(ids))).rows(
        session, {**numbered(ids), "caller": caller.user_id}
    )
    items = {facts["id"]: SequenceItem(**facts) for facts in sequence_facts(session, rows)}
    return [items[sequence_id] for sequence_id in ids]


@cache
def _of_ids(is_administrator: bool, places: int) -> KeptSelect:
    owner = None if is_administrator else parameter("caller")
    return KeptSelect(with_glances(select(SequenceRow).where(SequenceRow.id.in_(numbered_parameters(places))), owner))


@cache
def _label_sets(places: int) -> KeptSelect:
    """Return `LABELS` and the smallest picture, by ids."""
    named = (Artefact.label_set_id == LabelSet.id, Artefact.name.in_(PICTURES))
    picture = select(func.max(Artefact.name)).where(*named).scalar_subquery()
    return KeptSelect(select(*LABELS, picture).where(LabelSet.id.in_(numbered_parameters(places))))


def _label_facts(session: Session, ids: Sequence[str]) -> dict[str, tuple[dict[str, Any], str | None]]:
    """Return the facts and the picture of label sets, by id."""
    rows: Sequence[Sequence[Any]] = _label_sets(places_for(len(ids))).rows(session, numbered(ids)) if ids else ()
    return {row[0]: (_labels_said(row), row[-1]) for row in rows}


def _labels_said(row: Sequence[Any]) -> dict[str, Any]:
    id, job_id, frames, code_version, created_ns, chosen_ns, *quality, duration_ns, distance_m, t, p, n, _ = row
    made = {"id": id, "job_id": job_id, "frames": frames, "code_version": code_version}
    times = {"created_at": instant(created_ns), "chosen_at": instant(chosen_ns)}
    return {
        "labels": {**LabelQuality(*quality).as_record(), **made, **times},
        "class_voxels": None
        if None in (t, p, n)
        else dict(zip(ClassCounts.model_fields, (None, t, p, n), strict=True)),
        "duration_s": None if duration_ns is None else duration_ns / 1e9,
        "distance_m": distance_m,
    }


def sequence_detail(session: Session, sequence: SequenceRow, caller: Caller = VISITOR) -> SequenceDetail:
    """Return a sequence with the files of the active labels."""
    return _detail(session, dict(sequence_items(session, [sequence], caller)[0]), caller)


def shown_sequence_detail(session: Session, caller: Caller, sequence_id: str) -> SequenceDetail:
    """Return `sequence_detail` of a sequence that the caller may view, by cached statements. Raises `NotFoundError`."""
    kept = _shown_one(caller.is_administrator)
    rows = kept.rows(session, {"sequence": sequence_id, "caller": caller.user_id})
    if not rows:
        raise NotFoundError("sequence", sequence_id)
    return _detail(session, sequence_facts(session, rows)[0], caller)


@cache
def _shown_one(is_administrator: bool) -> KeptSelect:
    caller = None if is_administrator else parameter("caller")
    return KeptSelect(with_glances(sequences_shown(caller).where(SequenceRow.id == parameter("sequence")), caller))


def _detail(session: Session, facts: Mapping[str, Any], caller: Caller) -> SequenceDetail:
    """Return the detail of a sequence from its list item, and its files."""
    sequence_id, is_own = facts["id"], caller.is_administrator or facts["owner_id"] == caller.user_id
    labels = labels_of(session, sequence_id) if facts["labels"] else None
    artefacts = _artefacts(session, labels.id) if labels else []
    previews = previews_of_sequence(session, sequence_id, labels)
    sequence = session.get_one(SequenceRow, sequence_id) if is_own and labels else None
    later = later_recordings(session, sequence, labels) if sequence and labels else None
    return SequenceDetail(
        **facts,
        artefacts=artefacts,
        previews=previews,
        later_recordings=LaterRecordingsItem.of(later) if later else None,
    )


def _artefacts(session: Session, label_set_id: str) -> list[ArtefactItem]:
    return [
        ArtefactItem.of(row, sha256=row.blob_sha256)
        for row in _FILES.rows(session, {"labels": label_set_id})
        if not row.name.startswith(UNLISTED)
    ]


_FILES = KeptSelect(
    select(Artefact.name, Artefact.media_type, Artefact.size_bytes, Artefact.blob_sha256)
    .where(Artefact.label_set_id == parameter("labels"))
    .order_by(Artefact.name)
)
