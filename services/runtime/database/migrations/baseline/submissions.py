"""Submissions, their scores, the ledger of the teams' scorings, alarms."""

from sqlalchemy import JSON, BigInteger, CheckConstraint, Double, ForeignKey, Index, Integer, LargeBinary, String, Text

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
    "phase_teams",
    key("phase_id", ID, part_of("phases.id")),
    key("user_id", ID, part_of("users.id")),
    required("team_id", ID, part_of("teams.id")),
    *indexes("team_id"),
)

table(
    "submissions",
    key("id", ID),
    required("phase_id", ID, ForeignKey("phases.id")),
    required("team_id", ID, ForeignKey("teams.id")),
    required("user_id", ID, ForeignKey("users.id")),
    required("kind", String(16)),
    required("method", String(100)),
    required("description", Text),
    required("modality", String(8)),
    required("state", String(16)),
    required("declared_sha256", SHA256),
    required("size_bytes", BigInteger),
    optional("upload_id", ID, ForeignKey("uploads.id"), unique=True),
    optional("blob_sha256", SHA256, ForeignKey("blobs.sha256")),
    optional("job_id", ID, ForeignKey("jobs.id")),
    optional("problems", JSON),
    required("failure_code", String(64)),
    required("failure", String(2000)),
    required("revision", Integer),
    required("created_ns", BigInteger),
    optional("finalized_ns", BigInteger),
    optional("settled_ns", BigInteger),
    optional("withdrawn_ns", BigInteger),
    optional("hidden_ns", BigInteger),
    required("hidden_reason", String(512)),
    *indexes("blob_sha256", "job_id"),
    Index("ix_submissions_phase_state", "phase_id", "state"),
    *indexes("team_id", "user_id"),
    Index("ix_submissions_state_settled", "state", "settled_ns"),
    Index("ix_submissions_settled", "settled_ns"),
    partial_index(
        "ix_submissions_purgeable",
        "state IN ('valid', 'invalid', 'failed', 'cancelled') AND upload_id IS NOT NULL",
        "settled_ns",
    ),
    partial_index("ix_submissions_withdrawn", "upload_id IS NOT NULL", "state", "withdrawn_ns"),
    Index("ix_submissions_state_created", "state", "created_ns", "id"),
)

table(
    "scores",
    key("id", ID),
    required("submission_id", ID, part_of("submissions.id")),
    required("truth_id", ID, ForeignKey("ground_truths.id")),
    required("metric", String(32)),
    required("signature", String(300)),
    optional("iou_occ", Double),
    optional("iou_t", Double),
    optional("iou_p", Double),
    optional("iou_n", Double),
    optional("miou", Double),
    required("record", JSON),
    required("confusions_sha256", SHA256, ForeignKey("blobs.sha256")),
    required("spectra_sha256", SHA256, ForeignKey("blobs.sha256")),
    required("content_sha256", SHA256),
    required("created_ns", BigInteger),
    CheckConstraint("iou_n IS NULL OR (iou_n >= 0 AND iou_n <= 1)", name="iou_n_is_a_ratio"),
    CheckConstraint("iou_occ IS NULL OR (iou_occ >= 0 AND iou_occ <= 1)", name="iou_occ_is_a_ratio"),
    CheckConstraint("iou_p IS NULL OR (iou_p >= 0 AND iou_p <= 1)", name="iou_p_is_a_ratio"),
    CheckConstraint("iou_t IS NULL OR (iou_t >= 0 AND iou_t <= 1)", name="iou_t_is_a_ratio"),
    CheckConstraint("miou IS NULL OR (miou >= 0 AND miou <= 1)", name="miou_is_a_ratio"),
    Index("uq_scores_submission_truth_metric", "submission_id", "truth_id", "metric", unique=True),
    *indexes("confusions_sha256", "spectra_sha256", "content_sha256", "truth_id"),
)

table(
    "score_parts",
    key("submission_id", ID, part_of("submissions.id")),
    key("truth_id", ID, ForeignKey("ground_truths.id")),
    key("start", Integer),
    required("stop", Integer),
    required("counts", LargeBinary),
    required("problems", JSON),
    required("code_version", String(64), server_default=""),
)

table(
    "scoring_ledger",
    key("id", ID),
    required("phase_id", ID, ForeignKey("phases.id")),
    required("team_id", ID, ForeignKey("teams.id")),
    optional("submission_id", ID, ForeignKey("submissions.id")),
    required("amount", Integer),
    required("reason", String(64)),
    required("created_ns", BigInteger),
    Index("ix_scoring_ledger_phase_team", "phase_id", "team_id"),
    *indexes("submission_id"),
)

table(
    "alarms",
    key("id", ID),
    required("phase_id", ID, part_of("phases.id")),
    required("kind", String(32)),
    required("subject", String(128)),
    required("facts", JSON),
    required("created_ns", BigInteger),
    optional("dismissed_ns", BigInteger),
    *indexes("phase_id"),
    Index("uq_alarms_phase_kind_subject", "phase_id", "kind", "subject", unique=True),
)
