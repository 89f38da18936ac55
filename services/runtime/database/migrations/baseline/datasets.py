"""Versions of the dataset and their parts, the split."""

from sqlalchemy import BigInteger, Double, ForeignKey, Integer, String

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
    "splits",
    key("name", String(16)),
    required("revision", Integer),
    required("changed_ns", BigInteger),
)

table(
    "split_members",
    key("sequence_id", ID, part_of("sequences.id")),
    required("part", String(8)),
)

table(
    "datasets",
    key("id", ID),
    required("name", String(64), unique=True),
    required("licence", String(64)),
    required("code_version", String(64)),
    required("manifest_sha256", SHA256, ForeignKey("blobs.sha256")),
    required("manifest_bytes", BigInteger),
    required("created_by", ID, ForeignKey("users.id")),
    required("created_ns", BigInteger),
    *indexes("manifest_sha256"),
)

table(
    "dataset_members",
    key("dataset_id", ID, part_of("datasets.id")),
    key("sequence_id", ID),
    required("label_set_id", ID),
    required("part", String(8)),
    required("name", String(100)),
    required("environment", String(64)),
    required("illumination", String(64)),
    required("region", String(64)),
    required("recipe", String(64)),
    required("frames", Integer),
    required("duration_ns", BigInteger),
    optional("distance_m", Double),
    optional("t_voxels", BigInteger),
    optional("p_voxels", BigInteger),
    optional("n_voxels", BigInteger),
    *indexes("sequence_id"),
)

table(
    "dataset_parts",
    key("dataset_id", ID, part_of("datasets.id")),
    key("part", String(8)),
    required("index_sha256", SHA256, ForeignKey("blobs.sha256")),
    required("files", Integer),
    required("size_bytes", BigInteger),
    required("tar_bytes", BigInteger),
    required("tar_sha256", SHA256),
    *indexes("index_sha256"),
)

table(
    "dataset_packs",
    key("dataset_id", ID, part_of("datasets.id")),
    key("part", String(8)),
    key("ordinal", Integer),
    required("blob_sha256", SHA256, ForeignKey("blobs.sha256")),
    *indexes("blob_sha256"),
)

table(
    "dataset_inputs",
    key("dataset_id", ID, part_of("datasets.id")),
    key("name", String(100)),
    required("index_sha256", SHA256, ForeignKey("blobs.sha256")),
    required("files", Integer),
    required("size_bytes", BigInteger),
    required("tar_bytes", BigInteger),
    required("tar_sha256", SHA256),
    required("created_ns", BigInteger),
    *indexes("index_sha256"),
)

table(
    "dataset_input_packs",
    key("dataset_id", ID, part_of("datasets.id")),
    key("name", String(100)),
    key("ordinal", Integer),
    required("blob_sha256", SHA256, ForeignKey("blobs.sha256")),
    *indexes("blob_sha256"),
)
