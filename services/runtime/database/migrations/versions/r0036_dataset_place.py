"""The place of a dataset in place, also of its label sets; layout and grid as stated; files left out."""

import sqlalchemy as sa
from alembic import op

revision = "0036"
down_revision = "0035"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("label_sets", sa.Column("source_place", sa.JSON(), nullable=True))
    with op.batch_alter_table("dataset_imports") as imports:
        imports.add_column(sa.Column("place", sa.JSON(), nullable=True))
        imports.add_column(sa.Column("stated", sa.JSON(), nullable=True))
        imports.add_column(sa.Column("left_out", sa.JSON(), nullable=True))
        imports.alter_column("upload_id", existing_type=sa.String(length=32), nullable=True)


def downgrade() -> None:
    op.execute("DELETE FROM dataset_imports WHERE upload_id IS NULL")
    with op.batch_alter_table("dataset_imports") as imports:
        imports.alter_column("upload_id", existing_type=sa.String(length=32), nullable=False)
        imports.drop_column("left_out")
        imports.drop_column("stated")
        imports.drop_column("place")
    op.drop_column("label_sets", "source_place")
