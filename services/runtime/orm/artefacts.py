"""ORM models of products: blobs, artefacts, label sets and their frames."""

from sqlalchemy import ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from services.runtime.orm.base import Base, Bytes, Count, Id, Ns, Record, new_id, now_ns


class Blob(Base):
    """Bytes in the store. A row is deleted before its object, and a content stored again gets a new `object_key`, so
    nothing a row names is ever removed. Whoever refers to a blob does so by a foreign key, which forbids its deletion.
    """

    __tablename__ = "blobs"
    sha256: Mapped[str] = mapped_column(String(64), primary_key=True)
    object_key: Mapped[str] = mapped_column(String(160), unique=True)
    size_bytes: Mapped[Bytes]
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)


class LooseObject(Base):
    """An object of the store that no blob names: being written, or to be deleted (`is_condemned`).

    Whoever takes the row out has the object: `services/runtime/store/blobs.py` to make it a blob, or garbage
    collection, from which it is safe until `expected_ns` (when even a slow writer should be done) and the grace.
    """

    __tablename__ = "loose_objects"
    object_key: Mapped[str] = mapped_column(String(160), primary_key=True)
    is_condemned: Mapped[bool] = mapped_column(default=False)
    expected_ns: Mapped[Ns] = mapped_column(default=now_ns)

    __table_args__ = (Index("ix_loose_objects_condemned_expected", "is_condemned", "expected_ns"),)


class LabelSet(Base):
    """The labels of a sequence under one recipe (sha256 of inputs, parameters and code version); made once.

    Of several, the one that was asked for last counts: `chosen_ns`. What it adds up to (how long and how far the robot
    drove, voxels of all frames by class) is null where an earlier version did not write it down.
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
    """The place of a frame's `labels.npz`: a byte range [offset, offset + length) of a pack."""

    __tablename__ = "labelled_frames"
    label_set_id: Mapped[Id] = mapped_column(ForeignKey("label_sets.id", ondelete="CASCADE"), primary_key=True)
    ordinal: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    token: Mapped[str] = mapped_column(String(32), index=True)
    stamp_ns: Mapped[Ns]
    pack_id: Mapped[Id] = mapped_column(ForeignKey("artefacts.id", ondelete="CASCADE"))
    offset_bytes: Mapped[Bytes]
    length_bytes: Mapped[Bytes]
    sha256: Mapped[str] = mapped_column(String(64))
