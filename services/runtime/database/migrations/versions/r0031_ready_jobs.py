"""Ready jobs are found by one step down an index for each owner: the most urgent stand first in it."""

import sqlalchemy as sa
from alembic import op

revision = "0031"
down_revision = "0030"
branch_labels = None
depends_on = None

IS_READY = sa.text("state = 'queued' AND needs_left = 0")


def upgrade() -> None:
    _replaced(sa.text("priority DESC"))


def downgrade() -> None:
    _replaced(sa.text("priority"))


def _replaced(priority: sa.TextClause) -> None:
    op.drop_index("ix_jobs_ready", table_name="jobs")
    columns: list[str | sa.TextClause] = ["queue", "owner_id", priority, "root_id", "id"]
    op.create_index("ix_jobs_ready", "jobs", columns, sqlite_where=IS_READY, postgresql_where=IS_READY)
