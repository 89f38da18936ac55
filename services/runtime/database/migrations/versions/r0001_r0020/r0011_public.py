"""Sequences and benchmarks that may be looked at without an account; what there was stays private."""

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None

TABLES = ("sequences", "benchmarks")


def upgrade() -> None:
    for table in TABLES:
        op.add_column(table, sa.Column("is_public", sa.Boolean(), nullable=False, server_default=sa.false()))


def downgrade() -> None:
    for table in TABLES:
        with op.batch_alter_table(table) as altered:
            altered.drop_column("is_public")
