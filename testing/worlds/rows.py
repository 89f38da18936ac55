"""Rows that several tests create as the platform would."""

from services.runtime.orm import Recording, RecordingFile, Upload


def recording_of(
    upload: Upload, sequence_id: str, state: str = "received", blob_sha256: str | None = None
) -> Recording:
    """Return a recording of one file; set `blob_sha256` for a stored file."""
    file = RecordingFile(ordinal=0, upload_id=upload.id, filename=upload.filename, blob_sha256=blob_sha256)
    file.size_bytes, file.sha256 = upload.length_bytes, upload.sha256 or blob_sha256 or ""
    recording = Recording(sequence_id=sequence_id, filename=upload.filename, state=state, files=[file])
    recording.size_bytes, recording.sha256 = file.size_bytes, file.sha256
    return recording
