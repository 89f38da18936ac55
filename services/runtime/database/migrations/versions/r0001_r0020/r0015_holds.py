"""Garbage collection holds, taken while a backup is made."""

import sqlalchemy as sa
from alembic import op

revision = "0015"
down_revision = "0014"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "collection_holds",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("reason", sa.String(length=128), nullable=False),
        sa.Column("until_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_collection_holds")),
    )
    op.create_index(op.f("ix_collection_holds_until_ns"), "collection_holds", ["until_ns"], unique=False)


def downgrade() -> None:
    op.drop_table("collection_holds")
