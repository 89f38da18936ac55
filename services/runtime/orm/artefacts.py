"""ORM models of products: blobs, artefacts, label sets and their frames."""

from typing import Any

from sqlalchemy import JSON, ForeignKey, Index, String, false
from sqlalchemy.orm import Mapped, mapped_column

from services.runtime.orm.base import Base, Bytes, Count, Id, Ns, Record, WithQuality, new_id, now_ns


class Blob(Base):
    """Bytes in the store. A row is deleted before its object, and content that is stored again gets a new `object_key`.

    So every object that a row names exists. Refer to a blob by a foreign key, which forbids its deletion.
    """

    __tablename__ = "blobs"
    sha256: Mapped[str] = mapped_column(String(64), primary_key=True)
    object_key: Mapped[str] = mapped_column(String(160), unique=True)
    size_bytes: Mapped[Bytes]
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)


class LooseObject(Base):
    """An object of the store that no blob names: being written, or to be deleted (`is_condemned`).

    The process that deletes the row owns the object: `services/runtime/store/blobs.py` to create a blob, or garbage
    collection. Garbage collection spares it until `expected_ns` (when even a slow writer should be done) and the grace.
    """

    __tablename__ = "loose_objects"
    object_key: Mapped[str] = mapped_column(String(160), primary_key=True)
    is_condemned: Mapped[bool] = mapped_column(default=False)
    expected_ns: Mapped[Ns] = mapped_column(default=now_ns)

    __table_args__ = (Index("ix_loose_objects_condemned_expected", "is_condemned", "expected_ns"),)


class LabelSet(WithQuality, Base):
    """The labels of a sequence under one recipe (sha256 of inputs, parameters and code version); created once.

    The label set with the newest `chosen_ns` (last request) is active. Its totals (duration and distance of the drive,
    voxels of all frames by class) are null if an earlier version did not record them. `grid` is null for the paper's
    grid. `track` is a `DrivenTrack` (`stone/splits/drives.py`), loaded only by queries for it. `source_place` is the
    place of the dataset if the labels were imported in place.
    """

    __tablename__ = "label_sets"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    sequence_id: Mapped[Id] = mapped_column(ForeignKey("sequences.id", ondelete="CASCADE"), index=True)
    job_id: Mapped[Id] = mapped_column(ForeignKey("jobs.id"))
    recipe: Mapped[str] = mapped_column(String(64))
    parameters: Mapped[Record]
    code_version: Mapped[str] = mapped_column(String(64))
    frames: Mapped[int]
    duration_ns: Mapped[Ns | None]
    distance_m: Mapped[float | None]
    free_voxels: Mapped[Count | None]
    t_voxels: Mapped[Count | None]
    p_voxels: Mapped[Count | None]
    n_voxels: Mapped[Count | None]
    grid: Mapped[Record | None]
    source_place: Mapped[Record | None]
    track: Mapped[Record | None] = mapped_column(JSON, deferred=True)
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    chosen_ns: Mapped[Ns] = mapped_column(default=now_ns)

    __table_args__ = (Index("uq_label_sets_sequence_recipe", "sequence_id", "recipe", unique=True),)


class Artefact(Base):
    """One file of a label set: `report.json`, `bev.png`, `mesh.ply`, `frames.parquet`, `labels/000000.pack`."""

    __tablename__ = "artefacts"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    label_set_id: Mapped[Id] = mapped_column(ForeignKey("label_sets.id", ondelete="CASCADE"))
    name: Mapped[str] = mapped_column(String(128))
    media_type: Mapped[str] = mapped_column(String(64))
    blob_sha256: Mapped[str] = mapped_column(ForeignKey("blobs.sha256"), index=True)
    size_bytes: Mapped[Bytes]

    __table_args__ = (Index("uq_artefacts_label_set_name", "label_set_id", "name", unique=True),)


class LabelledFrameRow(Base):
    """The location of a frame's `labels.npz`: a byte range [offset, offset + length) of a pack."""

    __tablename__ = "labelled_frames"
    label_set_id: Mapped[Id] = mapped_column(ForeignKey("label_sets.id", ondelete="CASCADE"), primary_key=True)
    ordinal: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    token: Mapped[str] = mapped_column(String(32), index=True)
    stamp_ns: Mapped[Ns]
    pack_id: Mapped[Id] = mapped_column(ForeignKey("artefacts.id", ondelete="CASCADE"))
    offset_bytes: Mapped[Bytes]
    length_bytes: Mapped[Bytes]
    sha256: Mapped[str] = mapped_column(String(64))


# ORM models of exports and their packs.


class Export(Base):
    """One label set in one format, from its request on; `job_id` is the job that writes it.

    The columns below `finished_ns` are set with it, in the transaction of the job's success. `recipe` covers the label
    set, the format and the code version: an existing export is not created again.
    """

    __tablename__ = "exports"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    sequence_id: Mapped[Id] = mapped_column(ForeignKey("sequences.id", ondelete="CASCADE"))
    label_set_id: Mapped[Id] = mapped_column(ForeignKey("label_sets.id", ondelete="CASCADE"), index=True)
    job_id: Mapped[Id] = mapped_column(ForeignKey("jobs.id"))
    format: Mapped[str] = mapped_column(String(16))
    recipe: Mapped[str] = mapped_column(String(64))
    code_version: Mapped[str] = mapped_column(String(64))
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    finished_ns: Mapped[Ns | None]
    index_sha256: Mapped[str | None] = mapped_column(ForeignKey("blobs.sha256"), index=True)
    files: Mapped[int] = mapped_column(default=0)
    size_bytes: Mapped[Bytes] = mapped_column(default=0)
    tar_bytes: Mapped[Bytes] = mapped_column(default=0)
    tar_sha256: Mapped[str] = mapped_column(String(64), default="")
    zip_bytes: Mapped[Bytes] = mapped_column(default=0)
    zip_sha256: Mapped[str] = mapped_column(String(64), default="")

    __table_args__ = (Index("uq_exports_sequence_recipe", "sequence_id", "recipe", unique=True),)


class ExportPack(Base):
    """Files of an export one after another, as one blob; the export's index contains the pack and offset of each."""

    __tablename__ = "export_packs"
    export_id: Mapped[Id] = mapped_column(ForeignKey("exports.id", ondelete="CASCADE"), primary_key=True)
    ordinal: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    blob_sha256: Mapped[str] = mapped_column(ForeignKey("blobs.sha256"), index=True)
    size_bytes: Mapped[Bytes]


# ORM model of comparisons of two label sets.


class LabelComparison(Base):
    """A comparison of label sets A and B of a sequence, from its request on; `job_id` is the job that counts.

    `record` is set with `finished_ns`, in the transaction of the job's success. Label sets never change, so one
    comparison of a pair by one code version is enough.
    """

    __tablename__ = "label_comparisons"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    sequence_id: Mapped[Id] = mapped_column(ForeignKey("sequences.id", ondelete="CASCADE"), index=True)
    a_id: Mapped[Id] = mapped_column(ForeignKey("label_sets.id", ondelete="CASCADE"))
    b_id: Mapped[Id] = mapped_column(ForeignKey("label_sets.id", ondelete="CASCADE"), index=True)
    job_id: Mapped[Id] = mapped_column(ForeignKey("jobs.id"))
    code_version: Mapped[str] = mapped_column(String(64))
    record: Mapped[dict[str, Any] | None] = mapped_column(JSON)
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    finished_ns: Mapped[Ns | None]

    __table_args__ = (Index("uq_label_comparisons_pair", "a_id", "b_id", "code_version", unique=True),)


# ORM models of imports of published datasets, and the files that their scenes were made into.


class DatasetImport(Base):
    """The import of a dataset from one archive, from its request on; `job_id` is the run that imports it.

    `blob_sha256` is the archive, from its storage until the import succeeds. An archive in `place` has no upload and no
    blob. `classes` is the stated class map, null if labels use our numbers; `stated` are the layout and the grid that
    the owner states, null if none. `scenes` (name, frames, splits, region; at the end the sequence and the label set of
    each) is the content of the index, null before it is read. `existing` decides about a scene with the name of an
    existing sequence: refuse or add. `facts` are columns of every new sequence. `left_out` are files without a table
    entry that are too large to be kept: their total, and the first by name and size. `finished_ns` is set in the
    transaction that writes all its sequences.
    """

    __tablename__ = "dataset_imports"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    owner_id: Mapped[Id] = mapped_column(ForeignKey("users.id"))
    job_id: Mapped[Id] = mapped_column(ForeignKey("jobs.id"), index=True)
    upload_id: Mapped[Id | None] = mapped_column(ForeignKey("uploads.id"), unique=True)
    place: Mapped[Record | None]
    name: Mapped[str] = mapped_column(String(100))
    sha256: Mapped[str] = mapped_column(String(64))
    size_bytes: Mapped[Bytes]
    blob_sha256: Mapped[str | None] = mapped_column(ForeignKey("blobs.sha256"), index=True)
    classes: Mapped[dict[str, Any] | None] = mapped_column(JSON)
    stated: Mapped[Record | None]
    existing: Mapped[str] = mapped_column(String(8))
    sets_splits: Mapped[bool] = mapped_column(default=False, server_default=false())
    facts: Mapped[dict[str, Any]] = mapped_column(JSON, default=dict)
    scenes: Mapped[list[Any] | None] = mapped_column(JSON)
    left_out: Mapped[Record | None]
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    finished_ns: Mapped[Ns | None]

    __table_args__ = (Index("ix_dataset_imports_owner", "owner_id", "id"),)


class ImportedFile(Base):
    """An artefact of a finished scene until all scenes are finished; then it belongs to the label set.

    Files without a table entry have scene −1 and stay with the import.
    """

    __tablename__ = "imported_files"
    import_id: Mapped[Id] = mapped_column(ForeignKey("dataset_imports.id", ondelete="CASCADE"), primary_key=True)
    scene: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    name: Mapped[str] = mapped_column(String(128), primary_key=True)
    media_type: Mapped[str] = mapped_column(String(64))
    blob_sha256: Mapped[str] = mapped_column(ForeignKey("blobs.sha256"), index=True)
    size_bytes: Mapped[Bytes]
