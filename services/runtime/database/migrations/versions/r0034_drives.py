"""Tracks of label sets, from which drives are computed; drive and first stamp of sequences of dataset versions."""

import sqlalchemy as sa
from alembic import op

revision = "0034"
down_revision = "0033"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("label_sets", sa.Column("track", sa.JSON(), nullable=True))
    drive = sa.Column("drive", sa.String(100), nullable=False, server_default=sa.text("''"))
    op.add_column("dataset_members", drive)
    op.add_column("dataset_members", sa.Column("first_stamp_ns", sa.BigInteger(), nullable=True))


def downgrade() -> None:
    op.drop_column("dataset_members", "first_stamp_ns")
    op.drop_column("dataset_members", "drive")
    op.drop_column("label_sets", "track")
