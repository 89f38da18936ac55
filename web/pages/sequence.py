"""The page of a sequence: its labels frame by frame, its track, its calibration, its exports.

**Conventions.** One URL per section, so that each can be linked and opens quickly. These sections are visible to all
viewers of the sequence; `web/pages/sequence_own.py` has the owner's sections. `web/sequence` computes the view models.
"""

from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import HTMLResponse
from sqlalchemy import select

from api.deps import Caller, Looker
from api.schemas.base import ID_PATTERN
from api.views.exports import export_items
from api.views.ground_offer import ground_offer_of
from api.views.jobs import job_items
from api.views.scenes import artefact_file
from api.visible import exports_shown_to, labels_of, shown_sequence
from services.domain.sequences.label_choices import DEFAULT_PROFILE
from services.domain.viewer.playback import PLAYBACK, Playback, playback_of, shown_by
from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import Blob, CalibrationRow, Export, Job
from web.rig import stored_rig
from web.sequence.again import choices_of
from web.sequence.cameras import has_cameras
from web.sequence.export_formats import TITLES, offers_beside
from web.sequence.frame_table import NAME, FrameTable, frame_table
from web.sequence.recording import rig_place
from web.sequence.report import read_report
from web.sequence.sections import AtSequence, Visit, choosable, shown_section
from web.sequence.status import SequenceStatus, sequence_status_of
from web.sequence.timeline import timeline_of
from web.sequence.topic_choices import topic_choices_of
from web.sequence.track import track_of

router = APIRouter(prefix="/sequences/{sequence_id}")
FrameQuery = Annotated[str | None, Query(pattern=ID_PATTERN)]
MOST_EXPORTS = 50
OVERLAY, CAMERA = "overlay_", "CAM_"
DOWNLOADS = {
    "mesh.ply": ("mesh", "the mesh, classes by colour"),
    "report.json": ("report", "how the labels were made"),
    "frames.parquet": ("frames.parquet", "every frame with its pose"),
    "sequence.npz": ("sequence.npz", "the synchronised sequence"),
}
"""Files of labels by name: where below the sequence's route, and what they are."""


@router.get("")
def overview(at: AtSequence, caller: Looker) -> HTMLResponse:
    """Show the results of the sequence, or its next step."""
    with at.platform.database.reading() as session:
        status = sequence_status_of(session, caller, at.sequence_id)
        row = shown_sequence(session, caller, at.sequence_id)
        labels = labels_of(session, at.sequence_id)
        file = artefact_file(session, row, labels, "report.json")
        scene = artefact_file(session, row, labels, "scene/scene.json")
        is_setting_up = status.may_change and status.sequence.labels is None
        calibrations = choosable(session, caller, status) if is_setting_up else []
        choices = topic_choices_of(session, at.sequence_id) if is_setting_up else None
        again = choices_of(session, labels, DEFAULT_PROFILE) if status.may_process and not status.is_alive else None
    ground = ground_offer_of(at.platform, at.sequence_id) if is_setting_up else None
    return shown_section(
        at,
        (caller, status),
        "overview",
        needs_wasm=is_setting_up,
        has_scene=scene is not None,
        report=read_report(at.platform.store, file),
        downloads=[
            (*DOWNLOADS[artefact.name], artefact)
            for artefact in status.sequence.artefacts
            if artefact.name in DOWNLOADS
        ],
        may_set_up=is_setting_up,
        again=again,
        choices=choices,
        ground=ground,
        calibrations=calibrations,
    )


@router.get("/frames")
def frames(at: AtSequence, caller: Looker, frame: FrameQuery = None) -> HTMLResponse:
    """Show one frame at a time: its pictures and its labels from above, with a timeline."""
    status, table = _with_table(at, caller)
    labels, playback = status.sequence.labels, Playback(None, "none")
    with at.platform.database.reading() as session:
        if labels is not None:
            playback = playback_of(session, labels.id)
        has_pictures = has_cameras(session, at.sequence_id, table) is not False
    return shown_section(
        at,
        (caller, status),
        "frames",
        timeline=timeline_of(table, frame) if table is not None else None,
        playback=playback,
        has_cameras=has_pictures,
        cameras=sorted(shown_by(at.platform.store, playback).cameras, key=rig_place),
    )


@router.get("/track")
def track(at: AtSequence, caller: Looker) -> HTMLResponse:
    """Show the track: position, speed, elevation and the quality of the poses."""
    status, table = _with_table(at, caller)
    drawn = track_of(table) if table is not None else None
    return shown_section(at, (caller, status), "track", table=table, track=drawn)


@router.get("/calibration")
def calibration(at: AtSequence, caller: Looker) -> HTMLResponse:
    """Show the calibration of the labels, and whether LiDAR points coincide with the pictures."""
    status, table = _with_table(at, caller)
    with at.platform.database.reading() as session:
        calibrations = choosable(session, caller, status)
        is_blind = has_cameras(session, at.sequence_id, table) is False
        pinned = session.get(CalibrationRow, status.sequence.calibration_id or "")
        key = session.get_one(Blob, pinned.blob_sha256).object_key if pinned else ""
    rig, unread = stored_rig(at.platform.store, key, pinned.filename) if pinned else (None, "")
    overlays = [preview.name for preview in status.sequence.previews if preview.name.startswith(OVERLAY)]
    channels = sorted((name.removeprefix(OVERLAY).rpartition(".")[0] for name in overlays), key=rig_place)
    named = [(f"{OVERLAY}{channel}.jpg", _spoken(channel)) for channel in channels]
    return shown_section(
        at,
        (caller, status),
        "calibration",
        overlays=named,
        calibrations=calibrations,
        is_blind=is_blind,
        rig=rig,
        unread=unread,
    )


@router.get("/exports")
def exports(at: AtSequence, caller: Looker) -> HTMLResponse:
    """Show the labels in exported formats; those of a public sequence for every reader."""
    with at.platform.database.reading() as session:
        status = sequence_status_of(session, caller, at.sequence_id)
        asked_for = exports_shown_to(session, caller, at.sequence_id).where(Export.format != PLAYBACK)
        newest = asked_for.order_by(Export.id.desc())
        items = export_items(session, at.sequence_id, session.scalars(newest.limit(MOST_EXPORTS)).all())
        alive = select(Job).where(Job.id.in_([export.job_id for export in items]), Job.state.not_in(TERMINAL))
        progress = {job.id: job.progress for job in job_items(session, session.scalars(alive).all())}
    under_way = {export.id: progress[export.job_id] for export in items if export.job_id in progress}
    offers = offers_beside(items)
    looking = (caller, status)
    return shown_section(at, looking, "exports", exports=items, under_way=under_way, titles=TITLES, offers=offers)


def _spoken(channel: str) -> str:
    return channel.removeprefix(CAMERA).replace("_", " ").lower()


def _with_table(at: Visit, caller: Caller) -> tuple[SequenceStatus, FrameTable | None]:
    with at.platform.database.reading() as session:
        status = sequence_status_of(session, caller, at.sequence_id)
        row = shown_sequence(session, caller, at.sequence_id)
        file = artefact_file(session, row, labels_of(session, at.sequence_id), NAME)
    return status, None if file is None else frame_table(at.platform.store, file.object_key)
