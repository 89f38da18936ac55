"""Benchmarks, phases and their inputs, ground truths, rescores, reported rows."""

from sqlalchemy import JSON, BigInteger, Boolean, Double, ForeignKey, Index, Integer, String, Text, false, text

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
    "benchmarks",
    key("id", ID),
    required("name", String(64), unique=True),
    required("title", String(200)),
    required("description", Text),
    required("created_by", ID, ForeignKey("users.id")),
    required("created_ns", BigInteger),
    required("is_public", Boolean, server_default=false()),
)

table(
    "phases",
    key("id", ID),
    required("benchmark_id", ID, part_of("benchmarks.id")),
    required("name", String(32)),
    required("title", String(200)),
    required("dataset_id", ID, ForeignKey("datasets.id")),
    required("part", String(8)),
    required("mask", String(8)),
    required("is_hidden", Boolean),
    optional("opens_ns", BigInteger),
    optional("closes_ns", BigInteger),
    optional("named_from_ns", BigInteger),
    optional("scorings_per_window", Integer),
    required("window_ns", BigInteger),
    optional("scorings_total", Integer),
    required("validations_per_day", Integer),
    required("team_members", Integer),
    required("revision", Integer),
    required("created_ns", BigInteger),
    *indexes("dataset_id"),
    Index("uq_phases_benchmark_name", "benchmark_id", "name", unique=True),
    *indexes("opens_ns", "closes_ns"),
)

table(
    "ground_truths",
    key("id", ID),
    required("phase_id", ID, part_of("phases.id")),
    required("number", Integer),
    required("dataset_id", ID, ForeignKey("datasets.id")),
    required("part", String(8)),
    required("mask", String(8)),
    optional("job_id", ID, ForeignKey("jobs.id")),
    required("sha256", SHA256),
    required("frames", Integer),
    optional("manifest_sha256", SHA256, ForeignKey("blobs.sha256")),
    optional("pack_sha256", SHA256, ForeignKey("blobs.sha256")),
    required("facts", JSON),
    required("created_by", ID, ForeignKey("users.id")),
    required("created_ns", BigInteger),
    optional("ready_ns", BigInteger),
    *indexes("dataset_id", "manifest_sha256", "pack_sha256"),
    Index("uq_ground_truths_phase_number", "phase_id", "number", unique=True),
)

table(
    "activations",
    key("id", ID),
    required("phase_id", ID, part_of("phases.id")),
    required("truth_id", ID, ForeignKey("ground_truths.id")),
    required("metric", String(32)),
    optional("rescore_id", ID, ForeignKey("rescores.id")),
    required("activated_by", ID, ForeignKey("users.id")),
    required("activated_ns", BigInteger),
    *indexes("phase_id", "truth_id"),
)

table(
    "rescores",
    key("id", ID),
    required("phase_id", ID, part_of("phases.id")),
    required("truth_id", ID, ForeignKey("ground_truths.id")),
    required("metric", String(32)),
    optional("job_id", ID, ForeignKey("jobs.id")),
    required("reason", String(512)),
    required("created_by", ID, ForeignKey("users.id")),
    required("created_ns", BigInteger),
    optional("activated_ns", BigInteger),
    optional("abandoned_ns", BigInteger),
    *indexes("phase_id", "truth_id"),
)

table(
    "reported",
    key("id", ID),
    required("phase_id", ID, part_of("phases.id")),
    required("method", String(100)),
    required("modality", String(8)),
    required("source", String(300)),
    optional("iou_occ", Double),
    optional("iou_t", Double),
    optional("iou_p", Double),
    optional("iou_n", Double),
    optional("miou", Double),
    required("created_ns", BigInteger),
    required("note", String(600), server_default=""),
    required("percent_digits", Integer, server_default=text("2")),
    Index("uq_reported_phase_method", "phase_id", "method", "modality", unique=True),
)

table(
    "phase_inputs",
    key("phase_id", ID, part_of("phases.id")),
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
    "phase_input_packs",
    key("phase_id", ID, part_of("phases.id")),
    key("name", String(100)),
    key("ordinal", Integer),
    required("blob_sha256", SHA256, ForeignKey("blobs.sha256")),
    *indexes("blob_sha256"),
)
