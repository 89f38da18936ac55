"""ORM models of datasets: the draft splits, and published versions.

**Conventions.** A version is independent of its sources: its own rows contain the facts of its sequences, and foreign
keys to blobs keep its bytes. It stays unchanged when sequences are renamed, labelled again or deleted. The database
refuses changes of its rows; inputs are added to it.
"""

from sqlalchemy import ForeignKey, String, text
from sqlalchemy.orm import Mapped, mapped_column

from services.runtime.orm.base import Base, Bytes, Count, Id, Ns, Record, WithQuality, new_id, now_ns


class Splits(Base):
    """The draft splits, in one row; `revision` counts changes (ETag)."""

    __tablename__ = "splits"
    name: Mapped[str] = mapped_column(String(16), primary_key=True)
    revision: Mapped[int] = mapped_column(default=0)
    changed_ns: Mapped[Ns] = mapped_column(default=now_ns)


class SplitMember(Base):
    """A sequence in the draft splits: `part` is train, val or test."""

    __tablename__ = "split_members"
    sequence_id: Mapped[Id] = mapped_column(ForeignKey("sequences.id", ondelete="CASCADE"), primary_key=True)
    part: Mapped[str] = mapped_column(String(8))


class Dataset(Base):
    """A version of the dataset; its manifest is a blob, so the name identifies the content.

    `grid` is that of all its labels, null for the paper's.
    """

    __tablename__ = "datasets"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    name: Mapped[str] = mapped_column(String(64), unique=True)
    licence: Mapped[str] = mapped_column(String(64), default="")
    code_version: Mapped[str] = mapped_column(String(64))
    manifest_sha256: Mapped[str] = mapped_column(ForeignKey("blobs.sha256"), index=True)
    manifest_bytes: Mapped[Bytes]
    grid: Mapped[Record | None]
    created_by: Mapped[Id] = mapped_column(ForeignKey("users.id"))
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)


class DatasetMember(WithQuality, Base):
    """A sequence of a version at its publication; voxels and distance are null if they were unknown.

    `label_set_id` and `sequence_id` name its sources, which may be deleted since. `drive` names the drive that several
    sequences share, '' if the sequence is a whole drive; `first_stamp_ns` orders them, null if it is unknown.
    """

    __tablename__ = "dataset_members"
    dataset_id: Mapped[Id] = mapped_column(ForeignKey("datasets.id", ondelete="CASCADE"), primary_key=True)
    sequence_id: Mapped[Id] = mapped_column(primary_key=True, index=True)
    label_set_id: Mapped[Id]
    part: Mapped[str] = mapped_column(String(8))
    name: Mapped[str] = mapped_column(String(100))
    environment: Mapped[str] = mapped_column(String(64))
    illumination: Mapped[str] = mapped_column(String(64))
    region: Mapped[str] = mapped_column(String(64))
    recipe: Mapped[str] = mapped_column(String(64))
    frames: Mapped[int]
    duration_ns: Mapped[Ns]
    distance_m: Mapped[float | None]
    t_voxels: Mapped[Count | None]
    p_voxels: Mapped[Count | None]
    n_voxels: Mapped[Count | None]
    drive: Mapped[str] = mapped_column(String(100), default="", server_default=text("''"))
    first_stamp_ns: Mapped[Ns | None]


class DatasetPart(Base):
    """The files of one part of a version: an index with the pack and offset of each file, and the tar of all files.

    The files of test are never served, and it has no tar.
    """

    __tablename__ = "dataset_parts"
    dataset_id: Mapped[Id] = mapped_column(ForeignKey("datasets.id", ondelete="CASCADE"), primary_key=True)
    part: Mapped[str] = mapped_column(String(8), primary_key=True)
    index_sha256: Mapped[str] = mapped_column(ForeignKey("blobs.sha256"), index=True)
    files: Mapped[int]
    size_bytes: Mapped[Bytes]
    tar_bytes: Mapped[Bytes]
    tar_sha256: Mapped[str] = mapped_column(String(64), default="")


class DatasetPack(Base):
    """A blob that contains files of a part, numbered as in the index."""

    __tablename__ = "dataset_packs"
    dataset_id: Mapped[Id] = mapped_column(ForeignKey("datasets.id", ondelete="CASCADE"), primary_key=True)
    part: Mapped[str] = mapped_column(String(8), primary_key=True)
    ordinal: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    blob_sha256: Mapped[str] = mapped_column(ForeignKey("blobs.sha256"), index=True)


class DatasetInput(Base):
    """The sensor data of a sequence of train or val, without any label; `name` is the sequence's."""

    __tablename__ = "dataset_inputs"
    dataset_id: Mapped[Id] = mapped_column(ForeignKey("datasets.id", ondelete="CASCADE"), primary_key=True)
    name: Mapped[str] = mapped_column(String(100), primary_key=True)
    index_sha256: Mapped[str] = mapped_column(ForeignKey("blobs.sha256"), index=True)
    files: Mapped[int]
    size_bytes: Mapped[Bytes]
    tar_bytes: Mapped[Bytes]
    tar_sha256: Mapped[str] = mapped_column(String(64))
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)


class DatasetInputPack(Base):
    """A blob that contains files of an input, numbered as in its index."""

    __tablename__ = "dataset_input_packs"
    dataset_id: Mapped[Id] = mapped_column(ForeignKey("datasets.id", ondelete="CASCADE"), primary_key=True)
    name: Mapped[str] = mapped_column(String(100), primary_key=True)
    ordinal: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    blob_sha256: Mapped[str] = mapped_column(ForeignKey("blobs.sha256"), index=True)
