"""Held-out recall and gravest finding of label sets, and of the sequences of dataset versions."""

import sqlalchemy as sa
from alembic import op

revision = "0031"
down_revision = "0030"
branch_labels = None
depends_on = None

TABLES = ("label_sets", "dataset_members")
COLUMNS = ("held_out_recall", "held_out_m", "gravest_code", "gravest_severity")


def upgrade() -> None:
    for table in TABLES:
        for name, type_ in zip(COLUMNS, (sa.Double(), sa.Double(), sa.String(16), sa.String(8)), strict=True):
            op.add_column(table, sa.Column(name, type_, nullable=True))


def downgrade() -> None:
    for table in TABLES:
        for name in COLUMNS:
            op.drop_column(table, name)
