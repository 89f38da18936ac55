"""The browser session that approved a device grant; the grant ends with it."""

import sqlalchemy as sa
from alembic import op

revision = "0038"
down_revision = "0037"
branch_labels = None
depends_on = None


def upgrade() -> None:
    with op.batch_alter_table("device_grants") as grants:
        grants.add_column(sa.Column("session_id", sa.String(length=32), nullable=True))
        grants.create_foreign_key(
            "fk_device_grants_session_id", "web_sessions", ["session_id"], ["id"], ondelete="CASCADE"
        )
        grants.create_index("ix_device_grants_session_id", ["session_id"])


def downgrade() -> None:
    with op.batch_alter_table("device_grants") as grants:
        grants.drop_index("ix_device_grants_session_id")
        grants.drop_constraint("fk_device_grants_session_id", type_="foreignkey")
        grants.drop_column("session_id")
