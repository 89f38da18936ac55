"""Whether a sequence has cameras: a section is empty "not yet" only if something may come."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.orm import Recording
from web.sequence.frame_table import CAMERA, FrameTable
from web.sequence.topic_choices import MOST_READ


def has_cameras(session: Session, sequence_id: str, table: FrameTable | None) -> bool | None:
    """Return whether there are cameras, by the labels' frames, else by the registered recordings; None if unknown."""
    if table is not None and len(table):
        return bool(table.cameras)
    registered = Recording.sequence_id == sequence_id, Recording.state == "registered"
    read = session.scalars(select(Recording.inspection).where(*registered).limit(MOST_READ)).all()
    channels = [record.get("channels") or {} for record in read if record]
    if not channels:
        return None
    return any(name.startswith(CAMERA) for names in channels for name in names)
