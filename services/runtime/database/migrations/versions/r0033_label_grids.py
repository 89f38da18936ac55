"""The grid of label sets and of dataset versions: JSON, null for the paper's grid, which all earlier ones have."""

import sqlalchemy as sa
from alembic import op

revision = "0033"
down_revision = "0032"
branch_labels = None
depends_on = None


def upgrade() -> None:
    for table in ("label_sets", "datasets"):
        op.add_column(table, sa.Column("grid", sa.JSON(), nullable=True))


def downgrade() -> None:
    for table in ("label_sets", "datasets"):
        op.drop_column(table, "grid")
