"""Indexes for a million sequences: claims, lists and balances look at what they answer with, not at all there is."""

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None

READY = "state = 'queued' AND needs_left = 0"
IS_RUN = "id = root_id"
PARTIAL = (
    ("ix_jobs_ready", "jobs", ["queue", "owner_id", "priority", "root_id", "id"], READY),
    ("ix_jobs_running", "jobs", ["queue", "owner_id"], "state = 'running'"),
    ("ix_jobs_runs", "jobs", ["owner_id", "id"], IS_RUN),
    ("ix_jobs_run_kinds", "jobs", ["kind", "id"], IS_RUN),
)
WHOLE = (
    ("ix_sequences_owner", "sequences", ["owner_id", "id"]),
    ("ix_sequences_environment", "sequences", ["environment", "id"]),
    ("ix_sequences_illumination", "sequences", ["illumination", "id"]),
    ("ix_sequences_region", "sequences", ["region", "id"]),
    ("ix_sequences_platform", "sequences", ["platform", "id"]),
    ("ix_submissions_state_settled", "submissions", ["state", "settled_ns"]),
    ("ix_submissions_settled", "submissions", ["settled_ns"]),
    ("ix_dataset_members_sequence_id", "dataset_members", ["sequence_id"]),
    ("ix_quota_ledger_owner_amount", "quota_ledger", ["owner_id", "amount"]),
    ("ix_audit_log_act_number", "audit_log", ["act", "number"]),
    ("ix_audit_log_actor_number", "audit_log", ["actor", "number"]),
)
REPLACED = (
    ("ix_jobs_ready", "jobs", ["queue", "state", "needs_left", "priority", "id"]),
    ("ix_jobs_owner_id", "jobs", ["owner_id"]),
    ("ix_sequences_owner_id", "sequences", ["owner_id"]),
    ("ix_quota_ledger_owner_id", "quota_ledger", ["owner_id"]),
)


def upgrade() -> None:
    for name, table, _columns in REPLACED:
        op.drop_index(name, table_name=table)
    for name, table, columns, where in PARTIAL:
        op.create_index(name, table, columns, sqlite_where=sa.text(where), postgresql_where=sa.text(where))
    op.create_index(
        "ix_sequences_public", "sequences", ["id"],
        sqlite_where=sa.text("is_public = 1"), postgresql_where=sa.text("is_public"),
    )  # fmt: skip
    for name, table, columns in WHOLE:
        op.create_index(name, table, columns)


def downgrade() -> None:
    for name, table, _columns in WHOLE:
        op.drop_index(name, table_name=table)
    op.drop_index("ix_sequences_public", table_name="sequences")
    for name, table, _columns, _where in PARTIAL:
        op.drop_index(name, table_name=table)
    for name, table, columns in REPLACED:
        op.create_index(name, table, columns)
