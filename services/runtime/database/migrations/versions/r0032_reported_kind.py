"""The kind of reported rows: published results, and ceilings."""

import sqlalchemy as sa
from alembic import op

revision = "0032"
down_revision = "0031"
branch_labels = None
depends_on = None


def upgrade() -> None:
    kind = sa.Column("kind", sa.String(16), nullable=False, server_default=sa.text("'published'"))
    op.add_column("reported", kind)
    op.execute("UPDATE reported SET kind = 'ceiling' WHERE source LIKE 'stone ceiling --by %'")


def downgrade() -> None:
    op.drop_column("reported", "kind")
