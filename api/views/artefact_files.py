"""Downloads of a label set's artefact files."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from api.files import StoredFile
from services.runtime.orm import Artefact, Blob, LabelSet, SequenceRow


def artefact_file(session: Session, sequence: SequenceRow, labels: LabelSet | None, name: str) -> StoredFile | None:
    """A file of these labels, called after the sequence; None where there are no labels, or no such file."""
    if labels is None:
        return None
    named = select(Artefact, Blob).join(Blob, Blob.sha256 == Artefact.blob_sha256)
    row = session.execute(named.where(Artefact.label_set_id == labels.id, Artefact.name == name)).one_or_none()
    if row is None:
        return None
    artefact, blob = row
    filename = f"{sequence.name}-{name.replace('/', '-')}"
    return StoredFile(blob.object_key, blob.size_bytes, blob.sha256, artefact.media_type, filename)
