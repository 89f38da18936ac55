"""The splits of the dataset, its versions, and what a label set adds up to.

**Conventions.** How long a sequence lasts follows from its frames' stamps, so it is filled in for label sets there are;
distance and voxels are not in any row and stay unknown. Rows of versions cannot be updated; a version goes as a whole.
"""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None

SUMS: tuple[tuple[str, sa.types.TypeEngine[int] | sa.types.TypeEngine[float]], ...] = (
    ("duration_ns", sa.BigInteger()),
    ("distance_m", sa.Double()),
    ("free_voxels", sa.BigInteger()),
    ("t_voxels", sa.BigInteger()),
    ("p_voxels", sa.BigInteger()),
    ("n_voxels", sa.BigInteger()),
)
FROZEN = ("datasets", "dataset_members", "dataset_parts", "dataset_packs")
REFUSAL = "a version of the dataset does not change"


def upgrade() -> None:
    for name, kind in SUMS:
        op.add_column("label_sets", sa.Column(name, kind, nullable=True))
    _fill_durations()
    _splits()
    _datasets()
    _members()
    _parts()
    _freeze()


def downgrade() -> None:
    for table in reversed(FROZEN):
        op.drop_table(table)  # and its triggers with it
    if op.get_bind().dialect.name == "postgresql":
        op.execute("DROP FUNCTION refuse_dataset_change()")
    op.drop_table("split_members")
    op.drop_table("splits")
    with op.batch_alter_table("label_sets") as label_sets:
        for name, _kind in reversed(SUMS):
            label_sets.drop_column(name)


def _fill_durations() -> None:
    """The span of the stamps and one mean period, as `stone.splits.composition.duration_ns` has it."""
    span = "(max(stamp_ns) - min(stamp_ns)) / (count(*) - 1)"
    rest = "(max(stamp_ns) - min(stamp_ns)) % (count(*) - 1)"
    lasted = f"({span} * count(*) + {rest} * count(*) / (count(*) - 1))"
    of_frames = f"SELECT CASE WHEN count(*) < 2 THEN 0 ELSE {lasted} END FROM labelled_frames"
    op.execute(f"UPDATE label_sets SET duration_ns = ({of_frames} WHERE label_set_id = label_sets.id)")


def _splits() -> None:
    op.create_table(
        "splits",
        sa.Column("name", sa.String(length=16), nullable=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.Column("changed_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("name", name=op.f("pk_splits")),
    )
    op.create_table(
        "split_members",
        sa.Column("sequence_id", sa.String(length=32), nullable=False),
        sa.Column("part", sa.String(length=8), nullable=False),
        sa.ForeignKeyConstraint(
            ["sequence_id"], ["sequences.id"], name=op.f("fk_split_members_sequence_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("sequence_id", name=op.f("pk_split_members")),
    )


def _datasets() -> None:
    op.create_table(
        "datasets",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("licence", sa.String(length=64), nullable=False),
        sa.Column("code_version", sa.String(length=64), nullable=False),
        sa.Column("manifest_sha256", sa.String(length=64), nullable=False),
        sa.Column("manifest_bytes", sa.BigInteger(), nullable=False),
        sa.Column("created_by", sa.String(length=32), nullable=False),
        sa.Column("created_ns", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["created_by"], ["users.id"], name=op.f("fk_datasets_created_by")),
        sa.ForeignKeyConstraint(["manifest_sha256"], ["blobs.sha256"], name=op.f("fk_datasets_manifest_sha256")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_datasets")),
        sa.UniqueConstraint("name", name=op.f("uq_datasets_name")),
    )
    op.create_index(op.f("ix_datasets_manifest_sha256"), "datasets", ["manifest_sha256"], unique=False)


def _members() -> None:
    words = (("name", 100), ("environment", 64), ("illumination", 64), ("region", 64), ("recipe", 64))
    counts = ("t_voxels", "p_voxels", "n_voxels")
    op.create_table(
        "dataset_members",
        sa.Column("dataset_id", sa.String(length=32), nullable=False),
        sa.Column("sequence_id", sa.String(length=32), nullable=False),
        sa.Column("label_set_id", sa.String(length=32), nullable=False),
        sa.Column("part", sa.String(length=8), nullable=False),
        *(sa.Column(name, sa.String(length=length), nullable=False) for name, length in words),
        sa.Column("frames", sa.Integer(), nullable=False),
        sa.Column("duration_ns", sa.BigInteger(), nullable=False),
        sa.Column("distance_m", sa.Double(), nullable=True),
        *(sa.Column(name, sa.BigInteger(), nullable=True) for name in counts),
        _of_dataset("dataset_members"),
        sa.PrimaryKeyConstraint("dataset_id", "sequence_id", name=op.f("pk_dataset_members")),
    )


def _parts() -> None:
    op.create_table(
        "dataset_parts",
        sa.Column("dataset_id", sa.String(length=32), nullable=False),
        sa.Column("part", sa.String(length=8), nullable=False),
        sa.Column("index_sha256", sa.String(length=64), nullable=False),
        sa.Column("files", sa.Integer(), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("tar_bytes", sa.BigInteger(), nullable=False),
        sa.Column("tar_sha256", sa.String(length=64), nullable=False),
        _of_dataset("dataset_parts"),
        sa.ForeignKeyConstraint(["index_sha256"], ["blobs.sha256"], name=op.f("fk_dataset_parts_index_sha256")),
        sa.PrimaryKeyConstraint("dataset_id", "part", name=op.f("pk_dataset_parts")),
    )
    op.create_table(
        "dataset_packs",
        sa.Column("dataset_id", sa.String(length=32), nullable=False),
        sa.Column("part", sa.String(length=8), nullable=False),
        sa.Column("ordinal", sa.Integer(), nullable=False),
        sa.Column("blob_sha256", sa.String(length=64), nullable=False),
        _of_dataset("dataset_packs"),
        sa.ForeignKeyConstraint(["blob_sha256"], ["blobs.sha256"], name=op.f("fk_dataset_packs_blob_sha256")),
        sa.PrimaryKeyConstraint("dataset_id", "part", "ordinal", name=op.f("pk_dataset_packs")),
    )
    op.create_index(op.f("ix_dataset_parts_index_sha256"), "dataset_parts", ["index_sha256"], unique=False)
    op.create_index(op.f("ix_dataset_packs_blob_sha256"), "dataset_packs", ["blob_sha256"], unique=False)


def _of_dataset(table: str) -> sa.ForeignKeyConstraint:
    return sa.ForeignKeyConstraint(
        ["dataset_id"], ["datasets.id"], name=op.f(f"fk_{table}_dataset_id"), ondelete="CASCADE"
    )


def _freeze() -> None:
    if op.get_bind().dialect.name == "postgresql":
        body = f"BEGIN RAISE EXCEPTION '{REFUSAL}'; END"
        op.execute(f"CREATE FUNCTION refuse_dataset_change() RETURNS trigger LANGUAGE plpgsql AS $$ {body} $$")
    for table in FROZEN:
        if op.get_bind().dialect.name == "postgresql":
            refuse = "FOR EACH STATEMENT EXECUTE FUNCTION refuse_dataset_change()"
        else:
            refuse = f"BEGIN SELECT RAISE(ABORT, '{REFUSAL}'); END"
        op.execute(f"CREATE TRIGGER {table}_frozen BEFORE UPDATE ON {table} {refuse}")
