"""Traces and requests of jobs and uploads, and the counters of processes.

A job knows since when it is ready, so that the age of a queue is one step down an index.
"""

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None

READY = sa.text("state = 'queued' AND needs_left = 0")


def upgrade() -> None:
    op.add_column(
        "uploads", sa.Column("traceparent", sa.String(length=55), nullable=False, server_default=sa.text("''"))
    )
    op.add_column("jobs", sa.Column("traceparent", sa.String(length=55), nullable=False, server_default=sa.text("''")))
    op.add_column("jobs", sa.Column("request_id", sa.String(length=64), nullable=False, server_default=sa.text("''")))
    op.add_column("jobs", sa.Column("ready_ns", sa.BigInteger(), nullable=True))
    op.execute("UPDATE jobs SET ready_ns = created_ns WHERE state = 'queued' AND needs_left = 0 AND queue <> ''")
    op.create_index("ix_jobs_ready_since", "jobs", ["queue", "ready_ns"], sqlite_where=READY, postgresql_where=READY)
    _tallies()
    _chores()
    _figures()


def downgrade() -> None:
    for table in ("figures", "chores", "tallies"):
        op.drop_table(table)
    op.drop_index("ix_jobs_ready_since", table_name="jobs")
    with op.batch_alter_table("jobs") as jobs:
        for column in ("ready_ns", "request_id", "traceparent"):
            jobs.drop_column(column)
    with op.batch_alter_table("uploads") as uploads:
        uploads.drop_column("traceparent")


def _tallies() -> None:
    op.create_table(
        "tallies",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("counts", sa.JSON(), nullable=False),
        sa.Column("told_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_tallies")),
    )
    op.create_index(op.f("ix_tallies_told_ns"), "tallies", ["told_ns"], unique=False)


def _chores() -> None:
    op.create_table(
        "chores",
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("done_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("name", name=op.f("pk_chores")),
    )


def _figures() -> None:
    op.create_table(
        "figures",
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("value", sa.BigInteger(), nullable=False),
        sa.Column("measured_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("name", name=op.f("pk_figures")),
    )
