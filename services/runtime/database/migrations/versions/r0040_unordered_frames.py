"""Phases whose frames have no poses, stamps or order."""

import sqlalchemy as sa
from alembic import op

revision = "0040"
down_revision = "0039"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("phases", sa.Column("every_nth", sa.Integer(), nullable=True))
    op.add_column("phases", sa.Column("token_key", sa.String(64), nullable=True))


def downgrade() -> None:
    op.drop_column("phases", "token_key")
    op.drop_column("phases", "every_nth")
