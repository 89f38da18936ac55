"""A sequence created on a platform as the routes do it, and its jobs run in this process until none is left."""

import hashlib
import json
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.sequences.processing import ProcessRequest, start_processing
from services.domain.sequences.recordings import NewRecording, add_recording
from services.ingest import queue_handlers as ingest
from services.labeler import queue_handlers as labeler
from services.runtime.access.storage_quota import reserve
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.specs import Attempt, Handler, Outcome
from services.runtime.orm import (
    Artefact,
    Blob,
    CalibrationRow,
    Job,
    LabelledFrameRow,
    LabelSet,
    Recording,
    SequenceRow,
    Upload,
    User,
)
from services.runtime.platform import Platform
from services.runtime.store.blobs import keep
from services.runtime.uploads import upload_file
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate

# Two parts, several tiles, cameras in the calibration but no images.
SMALL = SimulateOptions(seconds=6.4, seed=3, channels=16, columns=180, cameras=False)
NAME = "field"

Wrap = Callable[[str, Handler], Handler]


def simulated(folder: Path) -> Path:
    """Return the recording that all of these tests share; its calibration lies beside it."""
    bag = folder / "run.mcap"
    simulate(bag, SMALL)
    return bag


@dataclass
class Brought:
    """A sequence on a platform, by ids."""

    platform: Platform
    owner_id: str
    sequence_id: str
    recording_ids: list[str] = field(default_factory=list)

    def sequence(self) -> SequenceRow:
        with self.platform.database.reading() as session:
            return session.get_one(SequenceRow, self.sequence_id)

    def recording(self, number: int = 0) -> Recording:
        with self.platform.database.reading() as session:
            return session.get_one(Recording, self.recording_ids[number])

    def job(self, job_id: str) -> Job:
        with self.platform.database.reading() as session:
            return session.get_one(Job, job_id)

    def jobs(self, root_id: str) -> list[Job]:
        with self.platform.database.reading() as session:
            return list(session.scalars(select(Job).where(Job.root_id == root_id).order_by(Job.id)))

    def label_sets(self) -> list[LabelSet]:
        with self.platform.database.reading() as session:
            return list(session.scalars(select(LabelSet).where(LabelSet.sequence_id == self.sequence_id)))

    def add(self, path: Path, filename: str = "") -> str:
        """Upload a file, or every file of a folder, as a recording; return the id of the job that reads it."""
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        received = NewRecording(
            tuple(
                uploaded(self.platform, self.owner_id, file, filename="" if path.is_dir() else filename)
                for file in files
            ),
            path.name,
        )
        with self.platform.database.transaction() as session:
            sequence = session.get_one(SequenceRow, self.sequence_id)
            recording, job = add_recording(session, sequence, received, self.owner_id)
            self.recording_ids.append(recording.id)
            return job.id

    def calibrate(self, path: Path) -> None:
        with self.platform.database.transaction() as session:
            blob = keep(session, self.platform.store, path)
            calibration = CalibrationRow(owner_id=self.owner_id, name="rig", version=1, filename=path.name)
            calibration.sha256 = calibration.blob_sha256 = blob.sha256
            calibration.sensors, calibration.findings = [], []
            session.add(calibration)
            session.flush()
            session.get_one(SequenceRow, self.sequence_id).calibration_id = calibration.id

    def process(self, **request: Any) -> str:
        """Start a run and return its id."""
        with self.platform.database.transaction() as session:
            sequence = session.get_one(SequenceRow, self.sequence_id)
            return start_processing(session, sequence, ProcessRequest(**request)).id

    def files(self) -> dict[str, bytes]:
        """Return every artefact of the one label set, with packs split into `<token>/labels.npz`."""
        with self.platform.database.reading() as session:
            rows = session.execute(select(Artefact, Blob).join(Blob, Blob.sha256 == Artefact.blob_sha256)).all()
            frames = session.scalars(select(LabelledFrameRow).order_by(LabelledFrameRow.ordinal)).all()
        content = {a.id: b"".join(self.platform.store.read(blob.object_key)) for a, blob in rows}
        files = {a.name: content[a.id] for a, _ in rows if not a.name.startswith("labels/")}
        for frame in frames:
            payload = content[frame.pack_id][frame.offset_bytes :][: frame.length_bytes]
            assert hashlib.sha256(payload).hexdigest() == frame.sha256
            files[f"{frame.token}/labels.npz"] = payload
        assert sum(len(content[a.id]) for a, _ in rows if a.name.startswith("labels/")) == sum(
            frame.length_bytes for frame in frames
        )
        return files


def uploaded(platform: Platform, owner_id: str, path: Path, *, purpose: str = "recording", filename: str = "") -> str:
    """Upload the file completely and return the upload's id."""
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    with platform.database.transaction() as session:
        facts = {"purpose": purpose, "filename": filename or path.name, "length_bytes": path.stat().st_size}
        upload = Upload(owner_id=owner_id, state="complete", expires_ns=0, sha256=sha256, **facts)
        session.add(upload)
        session.flush()
        reserve(session, owner_id, upload.length_bytes, upload.id, "upload", 2**40)
        kept = upload_file(platform.settings, upload.id)
        kept.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, kept)
        return upload.id


def bring(platform: Platform, name: str = NAME) -> Brought:
    """Create an owner with an empty sequence."""
    with platform.database.transaction() as session:
        owner = User(name=f"engineer-{name}", role="curator")
        session.add(owner)
        session.flush()
        sequence = SequenceRow(owner_id=owner.id, name=name)
        session.add(sequence)
        session.flush()
        return Brought(platform, owner.id, sequence.id)


def bring_ready(platform: Platform, bag: Path, name: str = NAME) -> Brought:
    """Create a sequence with its calibration and its registered recording."""
    brought = bring(platform, name)
    brought.calibrate(calibration_path(bag))
    brought.add(bag)
    run_all(platform)
    return brought


def unchanged(_kind: str, handler: Handler) -> Handler:
    return handler


def run_all(*platforms: Platform, wrap: Wrap = unchanged) -> int:
    """Run both queues until they are empty, alternating between platforms (machines); return the number of attempts."""
    tables = [
        (platform, queue, {kind: wrap(kind, handler) for kind, handler in made(platform).items()})
        for platform in platforms
        for queue, made in (("ingest", ingest.handlers), ("labeler", labeler.handlers))
    ]
    attempts = 0
    while ran := sum(run_next(*table) for table in tables):
        attempts += ran
    return attempts


@dataclass
class Said:
    """An attempt at `job` that counts its reports, and forwards them if there is a receiver."""

    job: Job
    words: list[int] = field(default_factory=list)
    heard_by: Attempt | None = None

    @property
    def job_id(self) -> str:
        return self.job.id

    @property
    def root_id(self) -> str:
        return self.job.root_id

    @property
    def sequence_id(self) -> str | None:
        return self.job.sequence_id

    @property
    def arguments(self) -> Mapping[str, Any]:
        return self.job.arguments

    def progress(self, stage: str, done: int, total: int) -> None:
        self.words.append(done)
        if self.heard_by:
            time.sleep(0.05)  # the time of a stage between two reports
            self.heard_by.progress(stage, done, total)

    def log(self, event: str, level: str = "info", **facts: Any) -> None:
        if self.heard_by:
            self.heard_by.log(event, level, **facts)


class Listening(Said):
    """An attempt whose report lasts until it detects the cancellation: the platform checks about twice a second."""

    def progress(self, stage: str, done: int, total: int) -> None:
        for _ in range(200):
            super().progress(stage, done, total)


@dataclass
class Interrupted:
    """An attempt that is interrupted at its second report, or else at its end."""

    attempt: Attempt
    words: int = 0

    @property
    def job_id(self) -> str:
        return self.attempt.job_id

    @property
    def root_id(self) -> str:
        return self.attempt.root_id

    @property
    def sequence_id(self) -> str | None:
        return self.attempt.sequence_id

    @property
    def arguments(self) -> Mapping[str, Any]:
        return self.attempt.arguments

    def progress(self, stage: str, done: int, total: int) -> None:
        self.words += 1
        if self.words == 2:
            raise RuntimeError("interrupted in the middle")
        self.attempt.progress(stage, done, total)

    def log(self, event: str, level: str = "info", **facts: Any) -> None:
        self.attempt.log(event, level, **facts)


class Interruptions:
    """Interrupt every kind of job once: at its second report, or else at its end; `publishing`, during the commit."""

    def __init__(self, publishing: str) -> None:
        self.publishing = publishing
        self.kinds: set[str] = set()

    def wrap(self, kind: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            if kind in self.kinds:
                return handler(attempt)
            self.kinds.add(kind)
            if kind == self.publishing:
                outcome = handler(attempt)
                return replace(outcome, commit=lambda session: _broken(outcome, session))
            handler(Interrupted(attempt))
            raise RuntimeError("interrupted at the end")

        return run


def _broken(outcome: Outcome, session: Session) -> None:
    outcome.commit(session)
    raise RuntimeError("interrupted in the commit")


def lost_once(*kinds: str, at_end: bool = True) -> Wrap:
    """Lose the first attempt at each job, of these kinds or any: in the middle, or at the end with nothing written."""
    seen: set[str] = set()

    def wrap(kind: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            if attempt.job_id in seen:
                return handler(attempt)
            seen.add(attempt.job_id)
            handler(attempt if at_end else Interrupted(attempt))
            raise RuntimeError("killed")

        return run if kind in kinds or not kinds else handler

    return wrap


def followed_by(act: Callable[[Session], object], platform: Platform, *kinds: str) -> Wrap:
    """Call `act` when a handler, of these kinds or any, has done its work and before its result is written."""

    def wrap(kind: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            outcome = handler(attempt)
            with platform.database.transaction() as session:
                act(session)
            return outcome

        return run if kind in kinds or not kinds else handler

    return wrap


def files_of_label(folder: Path) -> dict[str, bytes]:
    """Return the output of `stone label`, named as in `Brought.files` and without measurements."""
    paths = [path for path in (*folder.iterdir(), *folder.glob("scene/*")) if path.is_file()]
    files = {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}
    record = json.loads(files["report.json"])
    for name in ("stages_busy_s", "cpu_s", "peak_bytes"):
        del record[name]
    files["report.json"] = (json.dumps(record, indent=1) + "\n").encode()
    labels = (folder / "gts" / NAME).glob("*/labels.npz")
    return files | {f"{path.parent.name}/labels.npz": path.read_bytes() for path in labels}


def differing(ours: dict[str, bytes], theirs: dict[str, bytes]) -> list[str]:
    """Return the names of files that differ or exist in only one of them."""
    return sorted(name for name in ours.keys() | theirs.keys() if ours.get(name) != theirs.get(name))
