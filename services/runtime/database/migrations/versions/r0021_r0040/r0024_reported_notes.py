"""A reported row says what a reader must know of it, and with how many digits it was printed; old rows show two."""

import sqlalchemy as sa
from alembic import op

revision = "0024"
down_revision = "0023"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("reported", sa.Column("note", sa.String(length=600), nullable=False, server_default=sa.text("''")))
    op.add_column("reported", sa.Column("percent_digits", sa.Integer(), nullable=False, server_default=sa.text("2")))


def downgrade() -> None:
    op.drop_column("reported", "percent_digits")
    op.drop_column("reported", "note")
