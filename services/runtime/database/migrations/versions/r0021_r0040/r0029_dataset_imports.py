"""Imports of published datasets."""

import sqlalchemy as sa
from alembic import op

revision = "0029"
down_revision = "0028"
branch_labels = None
depends_on = None

IMPORTS, FILES = "dataset_imports", "imported_files"
ID = sa.String(length=32)


def upgrade() -> None:
    op.create_table(
        IMPORTS,
        sa.Column("id", ID, nullable=False),
        sa.Column("owner_id", ID, nullable=False),
        sa.Column("job_id", ID, nullable=False),
        sa.Column("upload_id", ID, nullable=False),
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("blob_sha256", sa.String(length=64), nullable=True),
        sa.Column("classes", sa.JSON(), nullable=True),
        sa.Column("existing", sa.String(length=8), nullable=False),
        sa.Column("sets_splits", sa.Boolean(), server_default=sa.false(), nullable=False),
        sa.Column("facts", sa.JSON(), nullable=False),
        sa.Column("scenes", sa.JSON(), nullable=True),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.Column("finished_ns", sa.BigInteger(), nullable=True),
        _refers(IMPORTS, "owner_id", "users.id"),
        _refers(IMPORTS, "job_id", "jobs.id"),
        _refers(IMPORTS, "upload_id", "uploads.id"),
        _refers(IMPORTS, "blob_sha256", "blobs.sha256"),
        sa.PrimaryKeyConstraint("id", name=op.f(f"pk_{IMPORTS}")),
        sa.UniqueConstraint("upload_id", name=op.f(f"uq_{IMPORTS}_upload_id")),
    )
    op.create_index(f"ix_{IMPORTS}_owner", IMPORTS, ["owner_id", "id"], unique=False)
    op.create_index(op.f(f"ix_{IMPORTS}_job_id"), IMPORTS, ["job_id"], unique=False)
    op.create_index(op.f(f"ix_{IMPORTS}_blob_sha256"), IMPORTS, ["blob_sha256"], unique=False)
    op.create_table(
        FILES,
        sa.Column("import_id", ID, nullable=False),
        sa.Column("scene", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("name", sa.String(length=128), nullable=False),
        sa.Column("media_type", sa.String(length=64), nullable=False),
        sa.Column("blob_sha256", sa.String(length=64), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        _refers(FILES, "import_id", "dataset_imports.id", ondelete="CASCADE"),
        _refers(FILES, "blob_sha256", "blobs.sha256"),
        sa.PrimaryKeyConstraint("import_id", "scene", "name", name=op.f(f"pk_{FILES}")),
    )
    op.create_index(op.f(f"ix_{FILES}_blob_sha256"), FILES, ["blob_sha256"], unique=False)


def downgrade() -> None:
    op.drop_table(FILES)
    op.drop_table(IMPORTS)


def _refers(table: str, column: str, target: str, ondelete: str | None = None) -> sa.ForeignKeyConstraint:
    return sa.ForeignKeyConstraint([column], [target], name=op.f(f"fk_{table}_{column}"), ondelete=ondelete)
