"""Submissions, their scores, and the ledger of what teams had scored.

**Conventions.** Scores and the ledger are only added to.
"""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None

TABLES = (
    "submissions",
    "alarms",
    "scores",
    "score_parts",
    "scoring_ledger",
)
FROZEN = ("scores", "scoring_ledger")
REFUSAL = "scores and the ledger of scorings are only added to"


def upgrade() -> None:
    _submissions()
    _alarms()
    _scores()
    _score_parts()
    _scoring_ledger()
    _freeze()


def downgrade() -> None:
    for table in reversed(TABLES):
        op.drop_table(table)  # and its triggers with it
    if op.get_bind().dialect.name == "postgresql":
        op.execute("DROP FUNCTION refuse_0010_change()")


def _submissions() -> None:
    op.create_table(
        "submissions",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("phase_id", sa.String(length=32), nullable=False),
        sa.Column("team_id", sa.String(length=32), nullable=False),
        sa.Column("user_id", sa.String(length=32), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("method", sa.String(length=100), nullable=False),
        sa.Column("description", sa.Text(), nullable=False),
        sa.Column("modality", sa.String(length=8), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("declared_sha256", sa.String(length=64), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("upload_id", sa.String(length=32), nullable=True),
        sa.Column("blob_sha256", sa.String(length=64), nullable=True),
        sa.Column("job_id", sa.String(length=32), nullable=True),
        sa.Column("problems", sa.JSON(), nullable=True),
        sa.Column("failure_code", sa.String(length=64), nullable=False),
        sa.Column("failure", sa.String(length=2000), nullable=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.Column("finalized_ns", sa.BigInteger(), nullable=True),
        sa.Column("settled_ns", sa.BigInteger(), nullable=True),
        sa.Column("withdrawn_ns", sa.BigInteger(), nullable=True),
        sa.Column("hidden_ns", sa.BigInteger(), nullable=True),
        sa.Column("hidden_reason", sa.String(length=512), nullable=False),
        sa.ForeignKeyConstraint(["blob_sha256"], ["blobs.sha256"], name=op.f("fk_submissions_blob_sha256")),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name=op.f("fk_submissions_job_id")),
        sa.ForeignKeyConstraint(["phase_id"], ["phases.id"], name=op.f("fk_submissions_phase_id")),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_submissions_team_id")),
        sa.ForeignKeyConstraint(["upload_id"], ["uploads.id"], name=op.f("fk_submissions_upload_id")),
        sa.ForeignKeyConstraint(["user_id"], ["users.id"], name=op.f("fk_submissions_user_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_submissions")),
        sa.UniqueConstraint("upload_id", name=op.f("uq_submissions_upload_id")),
    )
    op.create_index(op.f("ix_submissions_blob_sha256"), "submissions", ["blob_sha256"], unique=False)
    op.create_index(op.f("ix_submissions_job_id"), "submissions", ["job_id"], unique=False)
    op.create_index("ix_submissions_phase_state", "submissions", ["phase_id", "state"], unique=False)
    op.create_index(op.f("ix_submissions_team_id"), "submissions", ["team_id"], unique=False)
    op.create_index(op.f("ix_submissions_user_id"), "submissions", ["user_id"], unique=False)


def _alarms() -> None:
    op.create_table(
        "alarms",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("phase_id", sa.String(length=32), nullable=False),
        sa.Column("kind", sa.String(length=32), nullable=False),
        sa.Column("subject", sa.String(length=128), nullable=False),
        sa.Column("facts", sa.JSON(), nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.Column("dismissed_ns", sa.BigInteger(), nullable=True),
        sa.ForeignKeyConstraint(["phase_id"], ["phases.id"], name=op.f("fk_alarms_phase_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_alarms")),
    )
    op.create_index(op.f("ix_alarms_phase_id"), "alarms", ["phase_id"], unique=False)
    op.create_index("uq_alarms_phase_kind_subject", "alarms", ["phase_id", "kind", "subject"], unique=True)


def _scores() -> None:
    op.create_table(
        "scores",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("submission_id", sa.String(length=32), nullable=False),
        sa.Column("truth_id", sa.String(length=32), nullable=False),
        sa.Column("metric", sa.String(length=32), nullable=False),
        sa.Column("signature", sa.String(length=300), nullable=False),
        sa.Column("iou_occ", sa.Double(), nullable=True),
        sa.Column("iou_t", sa.Double(), nullable=True),
        sa.Column("iou_p", sa.Double(), nullable=True),
        sa.Column("iou_n", sa.Double(), nullable=True),
        sa.Column("miou", sa.Double(), nullable=True),
        sa.Column("record", sa.JSON(), nullable=False),
        sa.Column("confusions_sha256", sa.String(length=64), nullable=False),
        sa.Column("draws_sha256", sa.String(length=64), nullable=False),
        sa.Column("content_sha256", sa.String(length=64), nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("iou_n IS NULL OR (iou_n >= 0 AND iou_n <= 1)", name=op.f("ck_scores_iou_n_is_a_ratio")),
        sa.CheckConstraint(
            "iou_occ IS NULL OR (iou_occ >= 0 AND iou_occ <= 1)", name=op.f("ck_scores_iou_occ_is_a_ratio")
        ),
        sa.CheckConstraint("iou_p IS NULL OR (iou_p >= 0 AND iou_p <= 1)", name=op.f("ck_scores_iou_p_is_a_ratio")),
        sa.CheckConstraint("iou_t IS NULL OR (iou_t >= 0 AND iou_t <= 1)", name=op.f("ck_scores_iou_t_is_a_ratio")),
        sa.CheckConstraint("miou IS NULL OR (miou >= 0 AND miou <= 1)", name=op.f("ck_scores_miou_is_a_ratio")),
        sa.ForeignKeyConstraint(["confusions_sha256"], ["blobs.sha256"], name=op.f("fk_scores_confusions_sha256")),
        sa.ForeignKeyConstraint(["draws_sha256"], ["blobs.sha256"], name=op.f("fk_scores_draws_sha256")),
        sa.ForeignKeyConstraint(
            ["submission_id"], ["submissions.id"], name=op.f("fk_scores_submission_id"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(["truth_id"], ["ground_truths.id"], name=op.f("fk_scores_truth_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_scores")),
    )
    op.create_index(op.f("ix_scores_confusions_sha256"), "scores", ["confusions_sha256"], unique=False)
    op.create_index(op.f("ix_scores_content_sha256"), "scores", ["content_sha256"], unique=False)
    op.create_index(op.f("ix_scores_draws_sha256"), "scores", ["draws_sha256"], unique=False)
    op.create_index(op.f("ix_scores_truth_id"), "scores", ["truth_id"], unique=False)
    op.create_index("uq_scores_submission_truth_metric", "scores", ["submission_id", "truth_id", "metric"], unique=True)


def _score_parts() -> None:
    op.create_table(
        "score_parts",
        sa.Column("submission_id", sa.String(length=32), nullable=False),
        sa.Column("truth_id", sa.String(length=32), nullable=False),
        sa.Column("start", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("stop", sa.Integer(), nullable=False),
        sa.Column("counts", sa.LargeBinary(), nullable=False),
        sa.Column("problems", sa.JSON(), nullable=False),
        sa.ForeignKeyConstraint(
            ["submission_id"], ["submissions.id"], name=op.f("fk_score_parts_submission_id"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(["truth_id"], ["ground_truths.id"], name=op.f("fk_score_parts_truth_id")),
        sa.PrimaryKeyConstraint("submission_id", "truth_id", "start", name=op.f("pk_score_parts")),
    )


def _scoring_ledger() -> None:
    op.create_table(
        "scoring_ledger",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("phase_id", sa.String(length=32), nullable=False),
        sa.Column("team_id", sa.String(length=32), nullable=False),
        sa.Column("submission_id", sa.String(length=32), nullable=True),
        sa.Column("amount", sa.Integer(), nullable=False),
        sa.Column("reason", sa.String(length=64), nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["phase_id"], ["phases.id"], name=op.f("fk_scoring_ledger_phase_id")),
        sa.ForeignKeyConstraint(["submission_id"], ["submissions.id"], name=op.f("fk_scoring_ledger_submission_id")),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_scoring_ledger_team_id")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_scoring_ledger")),
    )
    op.create_index("ix_scoring_ledger_phase_team", "scoring_ledger", ["phase_id", "team_id"], unique=False)
    op.create_index(op.f("ix_scoring_ledger_submission_id"), "scoring_ledger", ["submission_id"], unique=False)


def _freeze() -> None:
    if op.get_bind().dialect.name == "postgresql":
        body = f"BEGIN RAISE EXCEPTION '{REFUSAL}'; END"
        op.execute(f"CREATE FUNCTION refuse_0010_change() RETURNS trigger LANGUAGE plpgsql AS $$ {body} $$")
    for table in FROZEN:
        if op.get_bind().dialect.name == "postgresql":
            refuse = "FOR EACH STATEMENT EXECUTE FUNCTION refuse_0010_change()"
        else:
            refuse = f"BEGIN SELECT RAISE(ABORT, '{REFUSAL}'); END"
        op.execute(f"CREATE TRIGGER {table}_frozen BEFORE UPDATE ON {table} {refuse}")
