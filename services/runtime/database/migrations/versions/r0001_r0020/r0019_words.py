"""Tables and columns are named by the field's words: counters, gc holds, upload parts and backends, replicates.

**Conventions.** The three small tables are made anew and filled, so that their constraints and indexes are named alike
on both databases; columns are renamed in place (SQLite copies `scores`, for the name of its foreign key).
"""

from collections.abc import Callable, Mapping

import sqlalchemy as sa
from alembic import op

from services.runtime.database.migrations.renames import name_reference, rename_column

revision = "0019"
down_revision = "0018"
branch_labels = None
depends_on = None

TABLES = {"tallies": "process_counters", "collection_holds": "gc_holds", "upload_slabs": "upload_parts"}
COLUMNS = {"uploads": {"place": "backend"}, "scores": {"draws_sha256": "replicates_sha256"}}
METRICS = {"stone_bells_rung_again": "stone_wake_ups_resent"}
"""New names by old ones."""


def upgrade() -> None:
    for old, new in TABLES.items():
        _move(old, new, MADE[old])
    for table, columns in COLUMNS.items():
        for column, named in columns.items():
            rename_column(table, column, named)
    name_reference("scores", "draws_sha256", "replicates_sha256")
    _rename_metrics("process_counters", METRICS)


def downgrade() -> None:
    _rename_metrics("process_counters", {new: old for old, new in METRICS.items()})
    for table, columns in COLUMNS.items():
        for column, named in columns.items():
            rename_column(table, named, column)
    name_reference("scores", "replicates_sha256", "draws_sha256")
    for old, new in TABLES.items():
        _move(new, old, MADE[old])


def _move(source: str, target: str, make: Callable[[str], None]) -> None:
    make(target)
    names = ", ".join(column["name"] for column in sa.inspect(op.get_bind()).get_columns(target))
    op.execute(f"INSERT INTO {target} ({names}) SELECT {names} FROM {source}")
    op.drop_table(source)


def _rename_metrics(table: str, names: Mapping[str, str]) -> None:
    """What was counted under an old name goes on under the new one: a count never falls."""
    rows = sa.table(table, sa.column("id", sa.String()), sa.column("counts", sa.JSON()))
    connection = op.get_bind()
    for row_id, counts in connection.execute(sa.select(rows.c.id, rows.c.counts)).all():
        if names.keys() & counts.keys():
            renamed = {names.get(name, name): of_metric for name, of_metric in counts.items()}
            connection.execute(sa.update(rows).where(rows.c.id == row_id).values(counts=renamed))


def _make_counters(name: str) -> None:
    op.create_table(
        name,
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("counts", sa.JSON(), nullable=False),
        sa.Column("told_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f(f"pk_{name}")),
    )
    op.create_index(op.f(f"ix_{name}_told_ns"), name, ["told_ns"], unique=False)


def _make_holds(name: str) -> None:
    op.create_table(
        name,
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("reason", sa.String(length=128), nullable=False),
        sa.Column("until_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f(f"pk_{name}")),
    )
    op.create_index(op.f(f"ix_{name}_until_ns"), name, ["until_ns"], unique=False)


def _make_parts(name: str) -> None:
    op.create_table(
        name,
        sa.Column("upload_id", sa.String(length=32), nullable=False),
        sa.Column("offset_bytes", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("length_bytes", sa.BigInteger(), nullable=False),
        sa.Column("object_key", sa.String(length=160), nullable=False),
        sa.Column("blob_sha256", sa.String(length=64), nullable=True),
        sa.ForeignKeyConstraint(["blob_sha256"], ["blobs.sha256"], name=op.f(f"fk_{name}_blob_sha256")),
        sa.ForeignKeyConstraint(["upload_id"], ["uploads.id"], name=op.f(f"fk_{name}_upload_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("upload_id", "offset_bytes", name=op.f(f"pk_{name}")),
    )
    for column in ("object_key", "blob_sha256"):
        op.create_index(op.f(f"ix_{name}_{column}"), name, [column], unique=False)
    first = sa.text("offset_bytes = 0")
    op.create_index(f"ix_{name}_first", name, ["upload_id"], sqlite_where=first, postgresql_where=first)


MADE = {"tallies": _make_counters, "collection_holds": _make_holds, "upload_slabs": _make_parts}
