"""Comparisons of two label sets of a sequence."""

import sqlalchemy as sa
from alembic import op

revision = "0028"
down_revision = "0027"
branch_labels = None
depends_on = None

TABLE = "label_comparisons"


def upgrade() -> None:
    op.create_table(
        TABLE,
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("sequence_id", sa.String(length=32), nullable=False),
        sa.Column("a_id", sa.String(length=32), nullable=False),
        sa.Column("b_id", sa.String(length=32), nullable=False),
        sa.Column("job_id", sa.String(length=32), nullable=False),
        sa.Column("code_version", sa.String(length=64), nullable=False),
        sa.Column("record", sa.JSON(), nullable=True),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.Column("finished_ns", sa.BigInteger(), nullable=True),
        _cascading("sequence_id", "sequences.id"),
        _cascading("a_id", "label_sets.id"),
        _cascading("b_id", "label_sets.id"),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name=op.f(f"fk_{TABLE}_job_id")),
        sa.PrimaryKeyConstraint("id", name=op.f(f"pk_{TABLE}")),
    )
    op.create_index(op.f(f"ix_{TABLE}_sequence_id"), TABLE, ["sequence_id"], unique=False)
    op.create_index(op.f(f"ix_{TABLE}_b_id"), TABLE, ["b_id"], unique=False)
    op.create_index(f"uq_{TABLE}_pair", TABLE, ["a_id", "b_id", "code_version"], unique=True)


def downgrade() -> None:
    op.drop_table(TABLE)


def _cascading(column: str, target: str) -> sa.ForeignKeyConstraint:
    return sa.ForeignKeyConstraint([column], [target], name=op.f(f"fk_{TABLE}_{column}"), ondelete="CASCADE")
