"""Sections of a sequence's page for its owner and administrators: recordings, runs, label sets.

**Conventions.** For other users the sections do not exist, even if the sequence is public.
"""

from fastapi import APIRouter
from fastapi.responses import HTMLResponse
from sqlalchemy import select
from sqlalchemy.orm import Session

from api.deps import Caller, Reader
from api.views.ground_offer import ground_offer_of
from api.views.label_sets import comparison_items, label_set_items
from api.views.recordings import recording_detail
from api.views.scenes import artefact_file
from api.visible import labels_of, sequence_of
from services.domain.sequences.label_choices import LabelProfile
from services.runtime.orm import LabelComparison, LabelSet, Recording
from web.boards.results import CLASS_NAMES, matrix
from web.sequence.again import choices_of
from web.sequence.recording import recording_view
from web.sequence.report import read_report
from web.sequence.sections import AtSequence, shown_section
from web.sequence.status import SequenceStatus, sequence_status_of
from web.sequence.topic_choices import topic_choices_of

router = APIRouter(prefix="/sequences/{sequence_id}")
MOST_SHOWN = 50


@router.get("/recordings")
def recordings(at: AtSequence, caller: Reader) -> HTMLResponse:
    """Show the recordings: uploads, the join of their clocks, and for each its clocks and quality."""
    with at.platform.database.reading() as session:
        status = _own(session, caller, at.sequence_id)
        of_sequence = select(Recording).where(Recording.sequence_id == at.sequence_id).order_by(Recording.id)
        shown = [recording_detail(session, row) for row in session.scalars(of_sequence.limit(MOST_SHOWN))]
        row, labels = sequence_of(session, caller, at.sequence_id), labels_of(session, at.sequence_id)
        file = artefact_file(session, row, labels, "report.json")
    report = read_report(at.platform.store, file)
    views = [
        recording_view(recording.inspection, recording.quality) if recording.inspection else None for recording in shown
    ]
    pairs = list(zip(shown, views, strict=True))
    joined = report.recordings if report else ()
    looking = (caller, status)
    return shown_section(at, looking, "recordings", needs_wasm=status.may_change, recordings=pairs, joined=joined)


@router.get("/processing")
def processing(at: AtSequence, caller: Reader, profile: LabelProfile | None = None) -> HTMLResponse:
    """Show the running and earlier runs; with `profile`, a form to process again with the last settings and this
    profile.
    """
    with at.platform.database.reading() as session:
        status = _own(session, caller, at.sequence_id)
        labels = labels_of(session, at.sequence_id)
        again = choices_of(session, labels, profile) if profile else None
        before = choices_of(session, labels)
        choices = topic_choices_of(session, at.sequence_id) if status.may_process else None
    ground = ground_offer_of(at.platform, at.sequence_id) if status.may_process else None
    return shown_section(at, (caller, status), "processing", again=again, before=before, choices=choices, ground=ground)


@router.get("/label-sets")
def label_sets(at: AtSequence, caller: Reader) -> HTMLResponse:
    """Show all label sets, and the agreement of pairs."""
    of_sequence, compared = LabelSet.sequence_id == at.sequence_id, LabelComparison.sequence_id == at.sequence_id
    with at.platform.database.reading() as session:
        status = _own(session, caller, at.sequence_id)
        rows = session.scalars(select(LabelSet).where(of_sequence).order_by(LabelSet.id.desc()).limit(MOST_SHOWN))
        sets = label_set_items(session, at.sequence_id, rows.all())
        newest = select(LabelComparison).where(compared).order_by(LabelComparison.id.desc())
        comparisons = comparison_items(session, session.scalars(newest.limit(MOST_SHOWN)).all())
    matrices = {item.id: matrix(item.record.all_voxels.confusion) for item in comparisons if item.record}
    return shown_section(
        at,
        (caller, status),
        "label-sets",
        label_sets={item.id: item for item in sets},
        comparisons=comparisons,
        matrices=matrices,
        class_names=CLASS_NAMES,
    )


def _own(session: Session, caller: Caller, sequence_id: str) -> SequenceStatus:
    """Return the status of an own sequence. Raises `NotFoundError` for other users' sequences."""
    sequence_of(session, caller, sequence_id)
    return sequence_status_of(session, caller, sequence_id)
