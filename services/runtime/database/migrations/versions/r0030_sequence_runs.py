"""The runs of a sequence have an index of their own: its newest is found however many jobs they are made of."""

import sqlalchemy as sa
from alembic import op

revision = "0030"
down_revision = "0029"
branch_labels = None
depends_on = None

IS_RUN = sa.text("id = root_id AND sequence_id IS NOT NULL")


def upgrade() -> None:
    op.create_index(
        "ix_jobs_sequence_runs", "jobs", ["sequence_id", "id"], sqlite_where=IS_RUN, postgresql_where=IS_RUN
    )


def downgrade() -> None:
    op.drop_index("ix_jobs_sequence_runs", table_name="jobs")
