"""ORM models of sequences, calibrations, topic profiles and uploads."""

from typing import Any

from sqlalchemy import JSON, ForeignKey, Index, String, false, text
from sqlalchemy.orm import Mapped, mapped_column, relationship, validates

from services.runtime.orm.base import Base, Bytes, Id, Ns, Record, new_id, now_ns, partial_index
from services.runtime.telemetry.origins import origin_trace

UPLOAD_WAITS = "state IN ('open', 'complete')"


class CalibrationRow(Base):
    """A calibration as uploaded; immutable. `sensors` is its summary; `findings` are the warnings of its checks.

    It applies to recordings in [valid_from_ns, valid_to_ns); a null limit is open.
    """

    __tablename__ = "calibrations"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    owner_id: Mapped[Id] = mapped_column(ForeignKey("users.id"), index=True)
    name: Mapped[str] = mapped_column(String(128))
    version: Mapped[int]
    filename: Mapped[str] = mapped_column(String(255))
    sha256: Mapped[str] = mapped_column(String(64))
    blob_sha256: Mapped[str] = mapped_column(ForeignKey("blobs.sha256"), index=True)
    sensors: Mapped[list[Any]] = mapped_column(JSON)
    findings: Mapped[list[Any]] = mapped_column(JSON)
    format: Mapped[str] = mapped_column(String(32), default="native")
    valid_from_ns: Mapped[Ns | None]
    valid_to_ns: Mapped[Ns | None]
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)

    __table_args__ = (Index("ix_calibrations_owner_name_version", "owner_id", "name", "version", unique=True),)


class ProfileRow(Base):
    """The topics of an owner's robot: `topics` maps a role or channel to a topic's name."""

    __tablename__ = "profiles"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    owner_id: Mapped[Id] = mapped_column(ForeignKey("users.id"))
    platform: Mapped[str] = mapped_column(String(64))
    topics: Mapped[dict[str, str]] = mapped_column(JSON)
    revision: Mapped[int] = mapped_column(default=1)
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)

    __table_args__ = (Index("uq_profiles_owner_platform", "owner_id", "platform", unique=True),)


class SequenceRow(Base):
    """One continuous run of the robot. `revision` counts changes (ETag); deleted: the row stays.

    All visitors may view the products of a public sequence, with or without an account. `published_ns` is the time when
    it first became public, and stays: its labels may have been downloaded.
    """

    __tablename__ = "sequences"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    owner_id: Mapped[Id] = mapped_column(ForeignKey("users.id"))
    name: Mapped[str] = mapped_column(String(100))
    environment: Mapped[str] = mapped_column(String(64), default="")
    illumination: Mapped[str] = mapped_column(String(64), default="")
    region: Mapped[str] = mapped_column(String(64), default="")
    platform: Mapped[str] = mapped_column(String(64), default="")
    calibration_id: Mapped[Id | None] = mapped_column(ForeignKey("calibrations.id"))
    is_public: Mapped[bool] = mapped_column(default=False, server_default=false())
    published_ns: Mapped[Ns | None]
    revision: Mapped[int] = mapped_column(default=1)
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    deleted_ns: Mapped[Ns | None]

    __table_args__ = (
        Index(
            "uq_sequences_owner_name_alive",
            "owner_id",
            "name",
            unique=True,
            sqlite_where=text("deleted_ns IS NULL"),
            postgresql_where=text("deleted_ns IS NULL"),
        ),
        Index("ix_sequences_owner", "owner_id", "id"),
        Index("ix_sequences_public", "id", sqlite_where=text("is_public = 1"), postgresql_where=text("is_public")),
        *(Index(f"ix_sequences_{name}", name, "id") for name in ("environment", "illumination", "region", "platform")),
    )

    @validates("is_public")
    def _remember(self, _key: str, is_public: bool) -> bool:
        """Record when it first became public."""
        if is_public and self.published_ns is None:
            self.published_ns = now_ns()
        return is_public


class Upload(Base):
    """An upload. Its offset is the number of received bytes, never a column; `backend`: folder or store.

    `state`: open, complete (all bytes present, sha256 verified), consumed (by a recording), failed, expired,
    terminated. Open and complete uploads wait and have indexes of their own, so the number of ended uploads does not
    slow queries.
    """

    __tablename__ = "uploads"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    owner_id: Mapped[Id] = mapped_column(ForeignKey("users.id"), index=True)
    purpose: Mapped[str] = mapped_column(String(32))
    target_id: Mapped[str] = mapped_column(String(64), default="")
    filename: Mapped[str] = mapped_column(String(255))
    length_bytes: Mapped[Bytes]
    declared_sha256: Mapped[str] = mapped_column(String(64), default="")
    sha256: Mapped[str] = mapped_column(String(64), default="", index=True)
    state: Mapped[str] = mapped_column(String(16), default="open")
    detail: Mapped[str] = mapped_column(String(512), default="")
    backend: Mapped[str] = mapped_column(String(8), default="folder", server_default=text("'folder'"))
    traceparent: Mapped[str] = mapped_column(String(55), default=origin_trace, server_default=text("''"))
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    expires_ns: Mapped[Ns]

    __table_args__ = (
        partial_index("ix_uploads_expiring", UPLOAD_WAITS, "expires_ns", "id"),
        partial_index("ix_uploads_waiting_owner", UPLOAD_WAITS, "owner_id"),
        partial_index("ix_uploads_waiting_target", UPLOAD_WAITS, "target_id"),
    )


# ORM models of recordings, their files and their previews.


class RecordingFile(Base):
    """One file of a recording, in the order of names. `blob_sha256` is set once the file is stored.

    If the file was cut off, `recovered_blob_sha256` is its readable part, which is processed instead.
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
    """One bag of a sequence: a file, or several files that are one bag and were sealed together.

    `filename`, `size_bytes` and `sha256` describe the whole (`stone_files/bag_fingerprint.py`). `state`: received,
    registered (read, and every file stored as a blob), refused (see `findings`).

    A recording with a `place` (`stone_recordings/sync/stored_recording.py`) stays in place: its `sha256` covers its
    files' sizes and versions and the parts that were read.
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
    place: Mapped[Record | None] = mapped_column(JSON)
    findings: Mapped[list[Any]] = mapped_column(JSON, default=list)
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    files: Mapped[list[RecordingFile]] = relationship(
        order_by=RecordingFile.ordinal, lazy="selectin", cascade="all, delete-orphan", passive_deletes=True
    )


class Preview(Base):
    """A picture or page of a recording, or (`recording_id` null) of the sequence that one `recipe` made."""

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


# ORM model of upload parts in the store.


FIRST = text("offset_bytes = 0")


class UploadPartRow(Base):
    """A run of an upload's bytes, one object of the store that never changes; the runs of an upload leave no gap.

    Several uploads of an owner may share an object. If it belongs to a blob, `blob_sha256` keeps it.
    """

    __tablename__ = "upload_parts"
    upload_id: Mapped[Id] = mapped_column(ForeignKey("uploads.id", ondelete="CASCADE"), primary_key=True)
    offset_bytes: Mapped[Bytes] = mapped_column(primary_key=True, autoincrement=False)
    length_bytes: Mapped[Bytes]
    object_key: Mapped[str] = mapped_column(String(160), index=True)
    blob_sha256: Mapped[str | None] = mapped_column(ForeignKey("blobs.sha256"), index=True)

    __table_args__ = (partial_index("ix_upload_parts_first", "offset_bytes = 0", "upload_id", "offset_bytes"),)
