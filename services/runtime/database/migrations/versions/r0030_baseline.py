"""The schema of the first release."""

from alembic import op

from services.runtime.database.migrations.baseline import create_schema, drop_schema

revision = "0030"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    create_schema(op.get_bind())


def downgrade() -> None:
    drop_schema(op.get_bind())
