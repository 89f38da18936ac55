"""The place of a recording that is read in place."""

import sqlalchemy as sa
from alembic import op

revision = "0035"
down_revision = "0034"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("recordings", sa.Column("place", sa.JSON(), nullable=True))


def downgrade() -> None:
    op.drop_column("recordings", "place")
