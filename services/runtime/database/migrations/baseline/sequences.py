"""Calibrations, sequences, recordings and their previews, uploads, profiles of robots."""

from sqlalchemy import JSON, BigInteger, Boolean, ForeignKey, Index, Integer, String, false, text

from services.runtime.database.migrations.baseline.tables import (
    ID,
    SHA256,
    indexes,
    key,
    optional,
    part_of,
    partial_index,
    required,
    table,
)

table(
    "calibrations",
    key("id", ID),
    required("owner_id", ID, ForeignKey("users.id")),
    required("name", String(128)),
    required("version", Integer),
    required("filename", String(255)),
    required("sha256", SHA256),
    required("blob_sha256", SHA256, ForeignKey("blobs.sha256")),
    required("sensors", JSON),
    required("findings", JSON),
    required("created_ns", BigInteger),
    required("format", String(32)),
    optional("valid_from_ns", BigInteger),
    optional("valid_to_ns", BigInteger),
    *indexes("owner_id", "blob_sha256"),
    Index("ix_calibrations_owner_name_version", "owner_id", "name", "version", unique=True),
)

table(
    "profiles",
    key("id", ID),
    required("owner_id", ID, ForeignKey("users.id")),
    required("platform", String(64)),
    required("topics", JSON),
    required("revision", Integer),
    required("created_ns", BigInteger),
    Index("uq_profiles_owner_platform", "owner_id", "platform", unique=True),
)

table(
    "sequences",
    key("id", ID),
    required("owner_id", ID, ForeignKey("users.id")),
    required("name", String(100)),
    required("environment", String(64)),
    required("illumination", String(64)),
    required("region", String(64)),
    required("platform", String(64)),
    optional("calibration_id", ID, ForeignKey("calibrations.id")),
    required("revision", Integer),
    required("created_ns", BigInteger),
    optional("deleted_ns", BigInteger),
    required("is_public", Boolean, server_default=false()),
    optional("published_ns", BigInteger),
    partial_index("uq_sequences_owner_name_alive", "deleted_ns IS NULL", "owner_id", "name", unique=True),
    Index("ix_sequences_public", "id", sqlite_where=text("is_public = 1"), postgresql_where=text("is_public")),
    Index("ix_sequences_owner", "owner_id", "id"),
    Index("ix_sequences_environment", "environment", "id"),
    Index("ix_sequences_illumination", "illumination", "id"),
    Index("ix_sequences_region", "region", "id"),
    Index("ix_sequences_platform", "platform", "id"),
)

IS_WAITING = "state IN ('open', 'complete')"

table(
    "uploads",
    key("id", ID),
    required("owner_id", ID, ForeignKey("users.id")),
    required("purpose", String(32)),
    required("target_id", String(64)),
    required("filename", String(255)),
    required("length_bytes", BigInteger),
    required("declared_sha256", SHA256),
    required("sha256", SHA256),
    required("state", String(16)),
    required("detail", String(512)),
    required("created_ns", BigInteger),
    required("expires_ns", BigInteger),
    required("traceparent", String(55), server_default=""),
    required("backend", String(8), server_default="folder"),
    *indexes("owner_id", "sha256"),
    partial_index("ix_uploads_expiring", IS_WAITING, "expires_ns", "id"),
    partial_index("ix_uploads_waiting_owner", IS_WAITING, "owner_id"),
    partial_index("ix_uploads_waiting_target", IS_WAITING, "target_id"),
)

table(
    "recording_files",
    key("id", ID),
    required("recording_id", ID, part_of("recordings.id")),
    required("ordinal", Integer),
    optional("upload_id", ID, ForeignKey("uploads.id"), unique=True),
    required("filename", String(255)),
    required("size_bytes", BigInteger),
    required("sha256", SHA256),
    optional("blob_sha256", SHA256, ForeignKey("blobs.sha256")),
    optional("recovered_blob_sha256", SHA256, ForeignKey("blobs.sha256")),
    *indexes("blob_sha256", "recovered_blob_sha256"),
    Index("uq_recording_files_recording_ordinal", "recording_id", "ordinal", unique=True),
)

table(
    "recordings",
    key("id", ID),
    required("sequence_id", ID, part_of("sequences.id")),
    required("filename", String(255)),
    required("size_bytes", BigInteger),
    required("sha256", SHA256),
    required("state", String(16)),
    optional("inspection", JSON),
    required("findings", JSON),
    required("created_ns", BigInteger),
    optional("quality", JSON),
    *indexes("sequence_id"),
)

table(
    "previews",
    key("id", ID),
    required("sequence_id", ID, part_of("sequences.id")),
    optional("recording_id", ID, part_of("recordings.id")),
    required("recipe", String(64)),
    required("name", String(128)),
    required("media_type", String(64)),
    required("blob_sha256", SHA256, ForeignKey("blobs.sha256")),
    required("size_bytes", BigInteger),
    *indexes("sequence_id", "blob_sha256"),
    Index("uq_previews_recording_name", "recording_id", "name", unique=True),
    partial_index(
        "uq_previews_sequence_recipe_name", "recording_id IS NULL", "sequence_id", "recipe", "name", unique=True
    ),
)

table(
    "upload_parts",
    key("upload_id", ID, part_of("uploads.id")),
    key("offset_bytes", BigInteger),
    required("length_bytes", BigInteger),
    required("object_key", String(160)),
    optional("blob_sha256", SHA256, ForeignKey("blobs.sha256")),
    *indexes("object_key", "blob_sha256"),
    partial_index("ix_upload_parts_first", "offset_bytes = 0", "upload_id", "offset_bytes"),
)
