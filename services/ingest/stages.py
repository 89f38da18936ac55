"""What ingest does in the queue: `register` reads a recording, `synchronise` makes a sequence of it.

**Conventions.** A stage is a function of the platform and an attempt; it may run twice, at once or after being killed
anywhere, and leaves the same bytes. Files for the labeler lie in the workspace of the run.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from sqlalchemy.orm import Session

from services.ingest.apart import Apart, folder_apart
from services.ingest.fingerprint import bag_parts
from services.ingest.named import named, named_folder
from services.ingest.pipeline import SynchroniseOptions
from services.ingest.received import NAMES_FOLDER
from services.ingest.registering import register
from services.ingest.samples import BagSamples
from services.ingest.sweep_file import Kept, KeptFile, read_sweeps
from services.ingest.sweeps import BagSweeps
from services.ingest.synchronising import SYNCHRONISED, Asked, synchronised
from services.runtime.atomic import flush
from services.runtime.blobs import link_all
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.specs import Attempt, Handlers, JobSpec, Outcome
from services.runtime.orm import Blob, Calibration, Recording, RecordingFile
from services.runtime.platform import Platform
from services.runtime.previews import PreparedPreview, Shown, prepared_previews, replace_previews
from services.runtime.processing import LABEL, REGISTER, SYNCHRONISE
from services.runtime.run_files import SEQUENCE_FILE, SWEEPS_FILE
from services.runtime.sample_sources import RecordingDeletedError
from services.runtime.stages import standing_sequence
from services.runtime.workspace import Workspace
from stone.sequence import Sequence


@dataclass(frozen=True)
class _Inputs:
    """What rows say of the inputs of a sequence."""

    name: str
    recording: Kept
    recording_sha256: str
    calibration: KeptFile
    valid_ns: tuple[int | None, int | None]


def handlers(platform: Platform) -> Handlers:
    """The stages by kind."""
    return {REGISTER: partial(register, platform), SYNCHRONISE: partial(synchronise_recording, platform)}


def synchronise_recording(platform: Platform, attempt: Attempt) -> Outcome:
    """Leave the sequence and the description of its sweeps in the workspace. Raises what `synchronised` raises."""
    inputs = _inputs(platform, attempt)
    attempt.progress(SYNCHRONISED, 0, 2)
    options = SynchroniseOptions(
        odometry_topic=attempt.arguments["odometry_topic"] or None,
        lidar_topic=attempt.arguments["lidar_topic"] or None,
        topics=attempt.arguments.get("topics", {}),
        recording_sha256=inputs.recording_sha256,
    )
    path, calibration = locate(platform, inputs.recording), locate_file(platform, inputs.calibration)
    asked = Asked(path, calibration, inputs.name, inputs.recording, inputs.valid_ns, options)
    workspace = Workspace(platform.store, platform.settings, attempt.root_id)
    with folder_apart(workspace.folder) as folder:
        made = synchronised(asked, Apart(folder, tuple(bag_parts(path)), attempt, platform.settings))
        attempt.progress(SYNCHRONISED, 1, 2)
        overlays = prepared_previews(platform, workspace.folder, made.overlays)
        for name, made_file in made.files.items():
            flush(made_file)
            made_file.replace(workspace.folder / name)
    workspace.push(SEQUENCE_FILE, SWEEPS_FILE)
    attempt.progress(SYNCHRONISED, 2, 2)
    attempt.log("synchronised", frames=made.result["frames"], excluded=made.result["excluded"])
    then = (JobSpec(LABEL),) if "label" in attempt.arguments["stages"] else ()
    shown = Shown(attempt.sequence_id or "", recipe=attempt.arguments["recipe"])
    return Outcome(made.result, then=then, commit=lambda session: _show(session, shown, overlays))


def open_described(platform: Platform, description: bytes) -> BagSweeps:
    """The sweeps that `synchronise_recording` described, wherever this worker finds the recording."""
    return read_sweeps(description, partial(locate, platform))


def open_recording(platform: Platform, recording_id: str, sequence: Sequence) -> BagSamples:
    """What the sensors gave for each frame of a sequence made of this recording. Raises `RecordingDeletedError`."""
    with platform.database.reading() as session:
        recording = session.get(Recording, recording_id)
        if recording is None:
            raise RecordingDeletedError(recording_id)
        kept = _kept(session, recording)
    return BagSamples(locate(platform, kept), sequence)


def locate(platform: Platform, kept: Kept) -> Path:
    """The bag on this machine, a file or a folder, called as its owner called it."""
    if len(kept.files) == 1:
        return locate_file(platform, kept.files[0])
    files = [(platform.store.local(file.object_key), file.filename) for file in kept.files]
    return named_folder(platform.settings.root / NAMES_FOLDER, files, kept.name)


def locate_file(platform: Platform, kept: KeptFile) -> Path:
    """A file on this machine with the object's bytes, called as its owner called it."""
    return named(platform.settings.root / NAMES_FOLDER, platform.store.local(kept.object_key), kept.filename)


def _show(session: Session, shown: Shown, overlays: tuple[PreparedPreview, ...]) -> None:
    link_all(session, (overlay.blob for overlay in overlays))
    replace_previews(session, shown, overlays)


def _inputs(platform: Platform, attempt: Attempt) -> _Inputs:
    with platform.database.reading() as session:
        sequence = standing_sequence(session, attempt)
        recording = session.get(Recording, attempt.arguments["recording_id"])
        if recording is None:
            raise JobCancelledError("its recording was deleted")
        kept = _kept(session, recording)
        calibration = session.get_one(Calibration, attempt.arguments["calibration_id"])
        rig = session.get_one(Blob, calibration.blob_sha256)
        valid_ns = (calibration.valid_from_ns, calibration.valid_to_ns)
    return _Inputs(sequence.name, kept, recording.sha256, KeptFile(rig.object_key, calibration.filename), valid_ns)


def _kept(session: Session, recording: Recording) -> Kept:
    return Kept(recording.filename, tuple(_kept_file(session, file) for file in recording.files))


def _kept_file(session: Session, file: RecordingFile) -> KeptFile:
    """What is read of a file: what was recovered of it, where it was cut off."""
    blob = session.get_one(Blob, file.recovered_blob_sha256 or file.blob_sha256)
    return KeptFile(blob.object_key, file.filename)
