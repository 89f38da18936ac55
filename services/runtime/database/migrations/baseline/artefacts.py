"""Blobs, label sets and their files, comparisons, exports, imports of published datasets."""

from sqlalchemy import JSON, BigInteger, Boolean, Double, ForeignKey, Index, Integer, String, false

from services.runtime.database.migrations.baseline.tables import (
    ID,
    SHA256,
    indexes,
    key,
    optional,
    part_of,
    required,
    table,
)

table(
    "blobs",
    key("sha256", SHA256),
    required("object_key", String(160), unique=True),
    required("size_bytes", BigInteger),
    required("created_ns", BigInteger),
)

table(
    "loose_objects",
    key("object_key", String(160)),
    required("is_condemned", Boolean),
    required("expected_ns", BigInteger),
    Index("ix_loose_objects_condemned_expected", "is_condemned", "expected_ns"),
)

table(
    "label_sets",
    key("id", ID),
    required("sequence_id", ID, part_of("sequences.id")),
    required("job_id", ID, ForeignKey("jobs.id")),
    required("recipe", String(64)),
    required("parameters", JSON),
    required("code_version", String(64)),
    required("frames", Integer),
    required("created_ns", BigInteger),
    required("chosen_ns", BigInteger),
    optional("duration_ns", BigInteger),
    optional("distance_m", Double),
    optional("free_voxels", BigInteger),
    optional("t_voxels", BigInteger),
    optional("p_voxels", BigInteger),
    optional("n_voxels", BigInteger),
    *indexes("sequence_id"),
    Index("uq_label_sets_sequence_recipe", "sequence_id", "recipe", unique=True),
)

table(
    "artefacts",
    key("id", ID),
    required("label_set_id", ID, part_of("label_sets.id")),
    required("name", String(128)),
    required("media_type", String(64)),
    required("blob_sha256", SHA256, ForeignKey("blobs.sha256")),
    required("size_bytes", BigInteger),
    *indexes("blob_sha256"),
    Index("uq_artefacts_label_set_name", "label_set_id", "name", unique=True),
)

table(
    "labelled_frames",
    key("label_set_id", ID, part_of("label_sets.id")),
    key("ordinal", Integer),
    required("token", String(32)),
    required("stamp_ns", BigInteger),
    required("pack_id", ID, part_of("artefacts.id")),
    required("offset_bytes", BigInteger),
    required("length_bytes", BigInteger),
    required("sha256", SHA256),
    *indexes("token"),
)

table(
    "exports",
    key("id", ID),
    required("sequence_id", ID, part_of("sequences.id")),
    required("label_set_id", ID, part_of("label_sets.id")),
    required("job_id", ID, ForeignKey("jobs.id")),
    required("format", String(16)),
    required("recipe", String(64)),
    required("code_version", String(64)),
    required("created_ns", BigInteger),
    optional("finished_ns", BigInteger),
    optional("index_sha256", SHA256, ForeignKey("blobs.sha256")),
    required("files", Integer),
    required("size_bytes", BigInteger),
    required("tar_bytes", BigInteger),
    required("tar_sha256", SHA256),
    required("zip_bytes", BigInteger),
    required("zip_sha256", SHA256),
    *indexes("index_sha256", "label_set_id"),
    Index("uq_exports_sequence_recipe", "sequence_id", "recipe", unique=True),
)

table(
    "export_packs",
    key("export_id", ID, part_of("exports.id")),
    key("ordinal", Integer),
    required("blob_sha256", SHA256, ForeignKey("blobs.sha256")),
    required("size_bytes", BigInteger),
    *indexes("blob_sha256"),
)

table(
    "label_comparisons",
    key("id", ID),
    required("sequence_id", ID, part_of("sequences.id")),
    required("a_id", ID, part_of("label_sets.id")),
    required("b_id", ID, part_of("label_sets.id")),
    required("job_id", ID, ForeignKey("jobs.id")),
    required("code_version", String(64)),
    optional("record", JSON),
    required("created_ns", BigInteger),
    optional("finished_ns", BigInteger),
    *indexes("sequence_id", "b_id"),
    Index("uq_label_comparisons_pair", "a_id", "b_id", "code_version", unique=True),
)

table(
    "dataset_imports",
    key("id", ID),
    required("owner_id", ID, ForeignKey("users.id")),
    required("job_id", ID, ForeignKey("jobs.id")),
    required("upload_id", ID, ForeignKey("uploads.id"), unique=True),
    required("name", String(100)),
    required("sha256", SHA256),
    required("size_bytes", BigInteger),
    optional("blob_sha256", SHA256, ForeignKey("blobs.sha256")),
    optional("classes", JSON),
    required("existing", String(8)),
    required("sets_splits", Boolean, server_default=false()),
    required("facts", JSON),
    optional("scenes", JSON),
    required("created_ns", BigInteger),
    optional("finished_ns", BigInteger),
    Index("ix_dataset_imports_owner", "owner_id", "id"),
    *indexes("job_id", "blob_sha256"),
)

table(
    "imported_files",
    key("import_id", ID, part_of("dataset_imports.id")),
    key("scene", Integer),
    key("name", String(128)),
    required("media_type", String(64)),
    required("blob_sha256", SHA256, ForeignKey("blobs.sha256")),
    required("size_bytes", BigInteger),
    *indexes("blob_sha256"),
)
