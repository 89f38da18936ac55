"""Jobs that wait for others of their run have an index of their own: they are counted however many others there are."""

import sqlalchemy as sa
from alembic import op

revision = "0018"
down_revision = "0017"
branch_labels = None
depends_on = None

IS_WAITING = sa.text("state = 'queued' AND needs_left > 0")


def upgrade() -> None:
    op.create_index("ix_jobs_waiting", "jobs", ["queue"], sqlite_where=IS_WAITING, postgresql_where=IS_WAITING)


def downgrade() -> None:
    op.drop_index("ix_jobs_waiting", table_name="jobs")
