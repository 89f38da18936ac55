"""A dataset imported as the routes do it, and the results of its import."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import func, select

from services.domain.imports.requests import NewImport, start_import
from services.runtime.access.storage_quota import balance
from services.runtime.orm import (
    Artefact,
    Blob,
    DatasetImport,
    ImportedFile,
    Job,
    LabelledFrameRow,
    LabelSet,
    SequenceRow,
    User,
    new_id,
)
from services.runtime.platform import Platform
from stone_recordings.sync.stored_recording import RecordingPlace
from testing.worlds.published_datasets import SyntheticDataset, made_labels
from testing.worlds.runs import uploaded

TAR_BYTES = 1000
LABELS = tuple(made_labels(seed) for seed in range(2))
FIELD = SyntheticDataset(frames=2, cameras=("CAM_FRONT",), radars=(), labels=LABELS, splits={"train": ["field-0000"]})


@dataclass(frozen=True)
class BroughtDataset:
    """An import on a platform, by ids."""

    platform: Platform
    owner_id: str
    import_id: str

    def row(self) -> DatasetImport:
        with self.platform.database.reading() as session:
            return session.get_one(DatasetImport, self.import_id)

    def run(self) -> Job:
        with self.platform.database.reading() as session:
            return session.get_one(Job, session.get_one(DatasetImport, self.import_id).job_id)

    def indexed(self, *names: str, splits: tuple[str, ...] = (), region: str = "") -> "BroughtDataset":
        """Set scenes of these names as its index would, and return itself."""
        with self.platform.database.transaction() as session:
            row = session.get_one(DatasetImport, self.import_id)
            facts = {"frames": 1, "splits": list(splits), "region": region}
            row.scenes = [{"name": name, **facts} for name in names]
        return self

    def jobs(self) -> list[Job]:
        with self.platform.database.reading() as session:
            root_id = session.get_one(DatasetImport, self.import_id).job_id
            return list(session.scalars(select(Job).where(Job.root_id == root_id).order_by(Job.id)))


def an_owner(platform: Platform, role: str = "curator") -> str:
    """Create a user and return its id."""
    with platform.database.transaction() as session:
        owner = User(id=new_id(), name=f"{role}-{new_id()[-8:]}", role=role)
        session.add(owner)
        return owner.id


def bring_dataset(platform: Platform, tar: Path, owner_id: str, **options: Any) -> BroughtDataset:
    """Start the import of a tar; keyword arguments as in `NewImport`."""
    upload_id = uploaded(platform, owner_id, tar, purpose="dataset")
    with platform.database.transaction() as session:
        owner = session.get_one(User, owner_id)
        imported, _ = start_import(session, owner, NewImport(upload_id=upload_id, **options))
        return BroughtDataset(platform, owner_id, imported.id)


def place_dataset(platform: Platform, place: RecordingPlace, owner_id: str, **options: Any) -> BroughtDataset:
    """Start the import of an archive in place; keyword arguments as in `NewImport`."""
    with platform.database.transaction() as session:
        owner, new = session.get_one(User, owner_id), NewImport(archive_place=place, **options)
        imported, _ = start_import(session, owner, new, platform.settings.in_place)
        return BroughtDataset(platform, owner_id, imported.id)


def files_of(platform: Platform, owner_id: str) -> dict[str, bytes]:
    """Return every artefact of every label set of the owner, as `<sequence>/<name>`; packs of labels frame by frame."""
    with platform.database.reading() as session:
        named = (
            select(SequenceRow.name, Artefact, Blob.object_key)
            .join(LabelSet, LabelSet.sequence_id == SequenceRow.id)
            .join(Artefact, Artefact.label_set_id == LabelSet.id)
            .join(Blob, Blob.sha256 == Artefact.blob_sha256)
            .where(SequenceRow.owner_id == owner_id)
        )
        rows = session.execute(named).all()
        frames = session.scalars(select(LabelledFrameRow).order_by(LabelledFrameRow.ordinal)).all()
    content = {artefact.id: b"".join(platform.store.read(key)) for _, artefact, key in rows}
    of = {artefact.id: name for name, artefact, _ in rows}
    files = {f"{name}/{it.name}": content[it.id] for name, it, _ in rows if not it.name.startswith("labels/")}
    for frame in frames:
        if frame.pack_id in content:
            payload = content[frame.pack_id][frame.offset_bytes :][: frame.length_bytes]
            assert hashlib.sha256(payload).hexdigest() == frame.sha256
            files[f"{of[frame.pack_id]}/{frame.token}/labels.npz"] = payload
    return files


def counts_of(platform: Platform, owner_id: str) -> dict[str, int]:
    """Return the numbers of rows that an import writes, and the bytes counted against the owner."""
    tables = (SequenceRow, LabelSet, Artefact, LabelledFrameRow, ImportedFile, DatasetImport)
    with platform.database.reading() as session:
        counts = {table.__tablename__: session.scalar(select(func.count()).select_from(table)) or 0 for table in tables}
        return {**counts, "bytes": balance(session, owner_id)}
