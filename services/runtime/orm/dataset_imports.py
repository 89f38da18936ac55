"""ORM models of imports of published datasets, and the files that their scenes were made into."""

from typing import Any

from sqlalchemy import JSON, ForeignKey, Index, String, false
from sqlalchemy.orm import Mapped, mapped_column

from services.runtime.orm.base import Base, Bytes, Id, Ns, new_id, now_ns


class DatasetImport(Base):
    """A dataset that came as one tar, since its import was asked for; `job_id` is the run that imports it, or has.

    `blob_sha256` is the tar while it is needed, from when it was kept until the import has ended well. `classes` is
    the stated class map, null where labels are numbered as ours; `scenes` (name, frames, splits, region; at the end
    the sequence and the label set of each) is what the index found, null before. `existing` says what becomes of a
    scene that is called as a sequence of the owner's: refuse or add. `facts` are columns of every sequence that is new.
    `finished_ns` is set in the transaction that writes all its sequences.
    """

    __tablename__ = "dataset_imports"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    owner_id: Mapped[Id] = mapped_column(ForeignKey("users.id"))
    job_id: Mapped[Id] = mapped_column(ForeignKey("jobs.id"), index=True)
    upload_id: Mapped[Id] = mapped_column(ForeignKey("uploads.id"), unique=True)
    name: Mapped[str] = mapped_column(String(100))
    sha256: Mapped[str] = mapped_column(String(64))
    size_bytes: Mapped[Bytes]
    blob_sha256: Mapped[str | None] = mapped_column(ForeignKey("blobs.sha256"), index=True)
    classes: Mapped[dict[str, Any] | None] = mapped_column(JSON)
    existing: Mapped[str] = mapped_column(String(8))
    sets_splits: Mapped[bool] = mapped_column(default=False, server_default=false())
    facts: Mapped[dict[str, Any]] = mapped_column(JSON, default=dict)
    scenes: Mapped[list[Any] | None] = mapped_column(JSON)
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    finished_ns: Mapped[Ns | None]

    __table_args__ = (Index("ix_dataset_imports_owner", "owner_id", "id"),)


class ImportedFile(Base):
    """An artefact of a scene that is done, until all are; then it belongs to the label set."""

    __tablename__ = "imported_files"
    import_id: Mapped[Id] = mapped_column(ForeignKey("dataset_imports.id", ondelete="CASCADE"), primary_key=True)
    scene: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    name: Mapped[str] = mapped_column(String(128), primary_key=True)
    media_type: Mapped[str] = mapped_column(String(64))
    blob_sha256: Mapped[str] = mapped_column(ForeignKey("blobs.sha256"), index=True)
    size_bytes: Mapped[Bytes]
