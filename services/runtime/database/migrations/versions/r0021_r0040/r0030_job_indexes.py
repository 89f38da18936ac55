"""Indexes of jobs: of the runs of a sequence, and of the ready ones with the most urgent first of each owner."""

import sqlalchemy as sa
from alembic import op

revision = "0030"
down_revision = "0029"
branch_labels = None
depends_on = None

IS_RUN = sa.text("id = root_id AND sequence_id IS NOT NULL")
IS_READY = sa.text("state = 'queued' AND needs_left = 0")


def upgrade() -> None:
    op.create_index(
        "ix_jobs_sequence_runs", "jobs", ["sequence_id", "id"], sqlite_where=IS_RUN, postgresql_where=IS_RUN
    )
    _ready_by(sa.text("priority DESC"))


def downgrade() -> None:
    op.drop_index("ix_jobs_sequence_runs", table_name="jobs")
    _ready_by(sa.text("priority"))


def _ready_by(priority: sa.TextClause) -> None:
    op.drop_index("ix_jobs_ready", table_name="jobs")
    columns: list[str | sa.TextClause] = ["queue", "owner_id", priority, "root_id", "id"]
    op.create_index("ix_jobs_ready", "jobs", columns, sqlite_where=IS_READY, postgresql_where=IS_READY)
