"""Exports: a label set in a format that others open, and the packs its files lie in."""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "exports",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("sequence_id", sa.String(length=32), nullable=False),
        sa.Column("label_set_id", sa.String(length=32), nullable=False),
        sa.Column("job_id", sa.String(length=32), nullable=False),
        sa.Column("format", sa.String(length=16), nullable=False),
        sa.Column("recipe", sa.String(length=64), nullable=False),
        sa.Column("code_version", sa.String(length=64), nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.Column("finished_ns", sa.BigInteger(), nullable=True),
        sa.Column("index_sha256", sa.String(length=64), nullable=True),
        sa.Column("files", sa.Integer(), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("tar_bytes", sa.BigInteger(), nullable=False),
        sa.Column("tar_sha256", sa.String(length=64), nullable=False),
        sa.Column("zip_bytes", sa.BigInteger(), nullable=False),
        sa.Column("zip_sha256", sa.String(length=64), nullable=False),
        sa.ForeignKeyConstraint(["index_sha256"], ["blobs.sha256"], name=op.f("fk_exports_index_sha256")),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], name=op.f("fk_exports_job_id")),
        sa.ForeignKeyConstraint(
            ["label_set_id"], ["label_sets.id"], name=op.f("fk_exports_label_set_id"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(
            ["sequence_id"], ["sequences.id"], name=op.f("fk_exports_sequence_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_exports")),
    )
    op.create_index(op.f("ix_exports_index_sha256"), "exports", ["index_sha256"], unique=False)
    op.create_index(op.f("ix_exports_label_set_id"), "exports", ["label_set_id"], unique=False)
    op.create_index("uq_exports_sequence_recipe", "exports", ["sequence_id", "recipe"], unique=True)
    _packs()


def downgrade() -> None:
    op.drop_table("export_packs")
    op.drop_table("exports")


def _packs() -> None:
    op.create_table(
        "export_packs",
        sa.Column("export_id", sa.String(length=32), nullable=False),
        sa.Column("ordinal", sa.Integer(), nullable=False),
        sa.Column("blob_sha256", sa.String(length=64), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["blob_sha256"], ["blobs.sha256"], name=op.f("fk_export_packs_blob_sha256")),
        sa.ForeignKeyConstraint(
            ["export_id"], ["exports.id"], name=op.f("fk_export_packs_export_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("export_id", "ordinal", name=op.f("pk_export_packs")),
    )
    op.create_index(op.f("ix_export_packs_blob_sha256"), "export_packs", ["blob_sha256"], unique=False)
