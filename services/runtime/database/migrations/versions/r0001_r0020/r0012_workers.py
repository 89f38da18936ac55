"""Presence of worker processes, and indexes of jobs by state and by the time they ended."""

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None

SIZES = ("held_bytes", "memory_free_bytes", "memory_bytes", "disk_free_bytes", "disk_bytes")


def upgrade() -> None:
    op.create_table(
        "workers",
        sa.Column("name", sa.String(length=128), nullable=False),
        sa.Column("queues", sa.String(length=64), nullable=False),
        sa.Column("beats", sa.BigInteger(), nullable=False),
        sa.Column("started_ns", sa.BigInteger(), nullable=False),
        sa.Column("beat_ns", sa.BigInteger(), nullable=False),
        *(sa.Column(name, sa.BigInteger(), nullable=True) for name in SIZES),
        sa.PrimaryKeyConstraint("name", name=op.f("pk_workers")),
    )
    op.create_index(op.f("ix_workers_beat_ns"), "workers", ["beat_ns"], unique=False)
    op.create_index("ix_jobs_state", "jobs", ["state", "id", "root_id"], unique=False)
    op.create_index("ix_jobs_finished", "jobs", ["finished_ns", "queue", "state"], unique=False)


def downgrade() -> None:
    op.drop_index("ix_jobs_finished", table_name="jobs")
    op.drop_index("ix_jobs_state", table_name="jobs")
    op.drop_table("workers")
