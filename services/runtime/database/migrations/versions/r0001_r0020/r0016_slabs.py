"""Upload parts in the store: an upload names the backend of its bytes, its parts are objects."""

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0015"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column(
        "uploads", sa.Column("place", sa.String(length=8), server_default=sa.text("'folder'"), nullable=False)
    )
    op.create_table(
        "upload_slabs",
        sa.Column("upload_id", sa.String(length=32), nullable=False),
        sa.Column("offset_bytes", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("length_bytes", sa.BigInteger(), nullable=False),
        sa.Column("object_key", sa.String(length=160), nullable=False),
        sa.Column("blob_sha256", sa.String(length=64), nullable=True),
        sa.ForeignKeyConstraint(["blob_sha256"], ["blobs.sha256"], name=op.f("fk_upload_slabs_blob_sha256")),
        sa.ForeignKeyConstraint(
            ["upload_id"], ["uploads.id"], name=op.f("fk_upload_slabs_upload_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("upload_id", "offset_bytes", name=op.f("pk_upload_slabs")),
    )
    for name in ("object_key", "blob_sha256"):
        op.create_index(op.f(f"ix_upload_slabs_{name}"), "upload_slabs", [name], unique=False)
    first = sa.text("offset_bytes = 0")
    op.create_index("ix_upload_slabs_first", "upload_slabs", ["upload_id"], sqlite_where=first, postgresql_where=first)


def downgrade() -> None:
    op.drop_table("upload_slabs")
    op.drop_column("uploads", "place")
