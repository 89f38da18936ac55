"""ORM models of recordings, their files and their previews."""

from typing import Any

from sqlalchemy import JSON, ForeignKey, Index, String, text
from sqlalchemy.orm import Mapped, mapped_column, relationship

from services.runtime.orm.base import Base, Bytes, Id, Ns, Record, new_id, now_ns


class RecordingFile(Base):
    """One file of a recording, in the order of names. `blob_sha256` once it is kept.

    Where the file was cut off, `recovered_blob_sha256` is what could be read of it; that is what is processed.
    """

    __tablename__ = "recording_files"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    recording_id: Mapped[Id] = mapped_column(ForeignKey("recordings.id", ondelete="CASCADE"))
    ordinal: Mapped[int]
    upload_id: Mapped[Id | None] = mapped_column(ForeignKey("uploads.id"), unique=True)
    filename: Mapped[str] = mapped_column(String(255))
    size_bytes: Mapped[Bytes]
    sha256: Mapped[str] = mapped_column(String(64))
    blob_sha256: Mapped[str | None] = mapped_column(ForeignKey("blobs.sha256"), index=True)
    recovered_blob_sha256: Mapped[str | None] = mapped_column(ForeignKey("blobs.sha256"), index=True)

    __table_args__ = (Index("uq_recording_files_recording_ordinal", "recording_id", "ordinal", unique=True),)


class Recording(Base):
    """One bag of a sequence: a file, or several that are one bag and were sealed together.

    `filename`, `size_bytes` and `sha256` are those of the whole (`stone_files/bag_files.py`). `state`:
    received, registered (read, and every file kept as a blob), refused (see `findings`).
    """

    __tablename__ = "recordings"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    sequence_id: Mapped[Id] = mapped_column(ForeignKey("sequences.id", ondelete="CASCADE"), index=True)
    filename: Mapped[str] = mapped_column(String(255))
    size_bytes: Mapped[Bytes]
    sha256: Mapped[str] = mapped_column(String(64))
    state: Mapped[str] = mapped_column(String(16), default="received")
    inspection: Mapped[Record | None] = mapped_column(JSON)
    quality: Mapped[Record | None] = mapped_column(JSON)
    findings: Mapped[list[Any]] = mapped_column(JSON, default=list)
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    files: Mapped[list[RecordingFile]] = relationship(
        order_by=RecordingFile.ordinal, lazy="selectin", cascade="all, delete-orphan", passive_deletes=True
    )


class Preview(Base):
    """A picture or page that shows a recording, or (`recording_id` null) the sequence that one `recipe` made of it."""

    __tablename__ = "previews"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    sequence_id: Mapped[Id] = mapped_column(ForeignKey("sequences.id", ondelete="CASCADE"))
    recording_id: Mapped[Id | None] = mapped_column(ForeignKey("recordings.id", ondelete="CASCADE"))
    recipe: Mapped[str] = mapped_column(String(64), default="")
    name: Mapped[str] = mapped_column(String(128))
    media_type: Mapped[str] = mapped_column(String(64))
    blob_sha256: Mapped[str] = mapped_column(ForeignKey("blobs.sha256"), index=True)
    size_bytes: Mapped[Bytes]

    __table_args__ = (
        Index("uq_previews_recording_name", "recording_id", "name", unique=True),
        Index(
            "uq_previews_sequence_recipe_name",
            "sequence_id",
            "recipe",
            "name",
            unique=True,
            sqlite_where=text("recording_id IS NULL"),
            postgresql_where=text("recording_id IS NULL"),
        ),
        Index("ix_previews_sequence_id", "sequence_id"),
    )
