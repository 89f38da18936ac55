"""The sensor data of a version's train and val sequences, beside its labels. What is made is never changed."""

import sqlalchemy as sa
from alembic import op

revision = "0025"
down_revision = "0024"
branch_labels = None
depends_on = None

TABLES = ("dataset_inputs", "dataset_input_packs")
REFUSAL = "a version of the dataset does not change"


def upgrade() -> None:
    _inputs()
    _packs()
    for table in TABLES:
        if op.get_bind().dialect.name == "postgresql":
            refuse = "FOR EACH STATEMENT EXECUTE FUNCTION refuse_dataset_change()"
        else:
            refuse = f"BEGIN SELECT RAISE(ABORT, '{REFUSAL}'); END"
        op.execute(f"CREATE TRIGGER {table}_frozen BEFORE UPDATE ON {table} {refuse}")


def downgrade() -> None:
    for table in reversed(TABLES):
        op.drop_table(table)  # and its triggers with it


def _inputs() -> None:
    op.create_table(
        "dataset_inputs",
        sa.Column("dataset_id", sa.String(length=32), nullable=False),
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("index_sha256", sa.String(length=64), nullable=False),
        sa.Column("files", sa.Integer(), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("tar_bytes", sa.BigInteger(), nullable=False),
        sa.Column("tar_sha256", sa.String(length=64), nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        _of_dataset("dataset_inputs"),
        sa.ForeignKeyConstraint(["index_sha256"], ["blobs.sha256"], name=op.f("fk_dataset_inputs_index_sha256")),
        sa.PrimaryKeyConstraint("dataset_id", "name", name=op.f("pk_dataset_inputs")),
    )
    op.create_index(op.f("ix_dataset_inputs_index_sha256"), "dataset_inputs", ["index_sha256"], unique=False)


def _packs() -> None:
    op.create_table(
        "dataset_input_packs",
        sa.Column("dataset_id", sa.String(length=32), nullable=False),
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("ordinal", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("blob_sha256", sa.String(length=64), nullable=False),
        _of_dataset("dataset_input_packs"),
        sa.ForeignKeyConstraint(["blob_sha256"], ["blobs.sha256"], name=op.f("fk_dataset_input_packs_blob_sha256")),
        sa.PrimaryKeyConstraint("dataset_id", "name", "ordinal", name=op.f("pk_dataset_input_packs")),
    )
    op.create_index(op.f("ix_dataset_input_packs_blob_sha256"), "dataset_input_packs", ["blob_sha256"], unique=False)


def _of_dataset(table: str) -> sa.ForeignKeyConstraint:
    return sa.ForeignKeyConstraint(
        ["dataset_id"], ["datasets.id"], name=op.f(f"fk_{table}_dataset_id"), ondelete="CASCADE"
    )
