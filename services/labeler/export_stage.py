"""The stage that exports: a labelled sequence of the platform → files in one format → packs in the store.

**Conventions.** An attempt works in a folder of its own, and removes that of an earlier one which was killed; the files
go from the folder into packs one by one, so the export lies on the disk once. Bytes are stored before any row; rows and
the job's success are one transaction, in which an export that was deleted meanwhile gets none.
"""

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from hashlib import sha256
from pathlib import Path
from secrets import token_hex

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.exports.requests import ExportResult, begin_export, write_export
from services.domain.sequences.run_files import SEQUENCE_FILE
from services.domain.sequences.stage_checks import require_sequence
from services.labeler.exports.errors import DamagedLabelsError
from services.labeler.exports.registry import exporter_of
from services.labeler.exports.source import MESH, REPORT, TABLE, LabelledSequence
from services.labeler.recordings import RecordingDeletedError, samples_of
from services.runtime.jobs.specs import Attempt, Outcome
from services.runtime.orm import Artefact, Blob, Export, LabelledFrameRow, LabelSet, Recording
from services.runtime.platform import Platform
from services.runtime.store.blobs import PreparedBlob, prepare
from services.runtime.store.folder import refusing_full
from services.runtime.store.pack_reading import archive_sha256, local_reader
from services.runtime.store.packs import PackedFiles, index_bytes, pack_count, pack_folder, pack_path
from services.runtime.store.protocol import Store
from services.runtime.store.workspace import Workspace
from stone.sensors.samples import CameraSample, LidarSample, RadarSample, SampleSource
from stone.sensors.sequence import Sequence
from stone_recordings.sync.sequence_file import read_sequence

INDEX = "index.npz"


@dataclass(frozen=True)
class _Range:
    """Where the labels of a frame lie, and what they hash to."""

    token: str
    object_key: str
    offset_bytes: int
    length_bytes: int
    sha256: str


@dataclass(frozen=True)
class _PackedLabels:
    """The labels of frames as ranges of packs."""

    store: Store
    ranges: tuple[_Range, ...]

    def __call__(self, index: int) -> bytes:
        """Raises `DamagedLabelsError`."""
        at = self.ranges[index]
        payload = b"".join(self.store.read(at.object_key, at.offset_bytes, at.offset_bytes + at.length_bytes))
        if sha256(payload).hexdigest() != at.sha256:
            raise DamagedLabelsError(Path(at.token) / "labels.npz", "its sha256 is another")
        return payload


@dataclass
class LateSamples:
    """Samples of the recording that a sequence was made of, opened when the first is asked for: a mesh asks for none.

    The recording is known by its content, so it may have been deleted and sent again.
    """

    platform: Platform
    sequence_id: str
    sequence: Sequence
    _opened: SampleSource | None = field(default=None)

    def lidar(self, index: int) -> LidarSample:
        return self._source().lidar(index)

    def camera(self, channel: str, index: int) -> CameraSample | None:
        return self._source().camera(channel, index)

    def radar(self, channel: str, index: int) -> RadarSample | None:
        return self._source().radar(channel, index)

    def _source(self) -> SampleSource:
        """Raises `RecordingDeletedError`."""
        if self._opened is None:
            self._opened = samples_of(self.platform, self._recording_id(), self.sequence)
        return self._opened

    def _recording_id(self) -> str:
        registered = (Recording.sequence_id == self.sequence_id, Recording.state == "registered")
        same = select(Recording.id).where(*registered, Recording.sha256.in_(self.sequence.inputs.values()))
        with self.platform.database.reading() as session:
            recording_id = session.scalar(same.order_by(Recording.id).limit(1))
        if recording_id is None:
            raise RecordingDeletedError(", ".join(self.sequence.inputs))
        return recording_id


def export(platform: Platform, attempt: Attempt) -> Outcome:
    """Write the export that the job is for.

    Raises `JobCancelledError` when it or its sequence was deleted, and what the exporter raises.
    """
    with platform.database.transaction() as session:
        require_sequence(session, attempt)
        row = begin_export(session, attempt)
    with attempt_folder(platform, attempt) as folder:
        files = _packed(platform, attempt, row, folder)
        made = _made(platform, attempt, folder, files)
    attempt.log("exported", format=row.format, files=len(files), size_bytes=made.size_bytes)
    limit_bytes = platform.settings.uploads.owner_bytes
    result = {"export_id": row.id, "format": row.format, "files": len(files), "size_bytes": made.size_bytes}
    return Outcome(result, commit=lambda session: write_export(session, attempt, made, limit_bytes))


def platform_source(platform: Platform, label_set_id: str, folder: Path) -> LabelledSequence:
    """A labelled sequence of the platform; `folder` gets links that call its files as they are called.

    Raises `ObjectMissingError`.
    """
    with platform.database.reading() as session:
        labels = session.get_one(LabelSet, label_set_id)
        named = select(Artefact.name, Blob.object_key).join(Blob, Blob.sha256 == Artefact.blob_sha256)
        keys = {name: key for name, key in session.execute(named.where(Artefact.label_set_id == label_set_id))}
        ranges = _ranges(session, label_set_id)
    folder.mkdir(parents=True, exist_ok=True)
    for name in (REPORT, SEQUENCE_FILE, MESH, TABLE):
        (folder / name).symlink_to(platform.store.local(keys[name]))
    sequence = read_sequence((folder / SEQUENCE_FILE).read_bytes())
    report = json.loads((folder / REPORT).read_text("utf-8"))
    samples = LateSamples(platform, labels.sequence_id, sequence)
    return LabelledSequence(
        sequence, samples, _PackedLabels(platform.store, ranges), report, folder / MESH, folder / TABLE
    )


def _ranges(session: Session, label_set_id: str) -> tuple[_Range, ...]:
    """Of all frames, in their order."""
    frames = (
        select(LabelledFrameRow, Blob.object_key)
        .join(Artefact, Artefact.id == LabelledFrameRow.pack_id)
        .join(Blob, Blob.sha256 == Artefact.blob_sha256)
        .where(LabelledFrameRow.label_set_id == label_set_id)
        .order_by(LabelledFrameRow.ordinal)
    )
    return tuple(
        _Range(frame.token, key, frame.offset_bytes, frame.length_bytes, frame.sha256)
        for frame, key in session.execute(frames)
    )


@contextmanager
def attempt_folder(platform: Platform, attempt: Attempt) -> Iterator[Path]:
    """A fresh folder of this attempt; it stays when all went well, since what is stored is linked to it."""
    work = Workspace(platform.store, platform.settings, attempt.root_id).folder
    for earlier in work.glob(f"export-{attempt.job_id}-*"):
        shutil.rmtree(earlier, ignore_errors=True)
    folder = work / f"export-{attempt.job_id}-{token_hex(8)}"
    try:
        with refusing_full(work):
            folder.mkdir()
            yield folder
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def pack_files(attempt: Attempt, folder: Path) -> PackedFiles:
    """Move what lies in `files` of the attempt's folder into packs, and write their index."""
    files = pack_folder(folder / "files", folder / "packs", partial(attempt.progress, "pack"))
    (folder / INDEX).write_bytes(index_bytes(files))
    return files


def stored_packs(platform: Platform, attempt: Attempt, folder: Path, files: PackedFiles) -> list[PreparedBlob]:
    """The index and the packs, in the store."""
    paths = [folder / INDEX, *(pack_path(folder / "packs", number) for number in range(pack_count(files)))]
    prepared = list[PreparedBlob]()
    for path in paths:
        attempt.progress("store", len(prepared), len(paths))
        prepared.append(prepare(platform.store, platform.database, path, adopt=True))
    attempt.progress("store", len(paths), len(paths))
    return prepared


def _packed(platform: Platform, attempt: Attempt, row: Export, folder: Path) -> PackedFiles:
    """Have the files written, then move them into packs."""
    source = platform_source(platform, row.label_set_id, folder / "inputs")
    (folder / "files").mkdir()
    exporter_of(row.format)(source, folder / "files", partial(attempt.progress, row.format))
    return pack_files(attempt, folder)


def _made(platform: Platform, attempt: Attempt, folder: Path, files: PackedFiles) -> ExportResult:
    """Hash what the archives will be, and store packs and index."""
    read = local_reader(folder / "packs")
    tar = archive_sha256(files, "tar", read, partial(attempt.progress, "tar"))
    zipped = archive_sha256(files, "zip", read, partial(attempt.progress, "zip"))
    index, *packs = stored_packs(platform, attempt, folder, files)
    return ExportResult(files, index, packs, tar, zipped)
