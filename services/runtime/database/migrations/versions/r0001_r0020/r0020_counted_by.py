"""Parts of a score say which code counted them, so that none is joined with those of another over an upgrade."""

import sqlalchemy as sa
from alembic import op

revision = "0020"
down_revision = "0019"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column(
        "score_parts", sa.Column("code_version", sa.String(length=64), nullable=False, server_default=sa.text("''"))
    )


def downgrade() -> None:
    op.drop_column("score_parts", "code_version")
