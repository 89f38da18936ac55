"""Renaming columns in migrations, on both databases."""

import sqlalchemy as sa
from alembic import op


def rename_column(table: str, column: str, named: str) -> None:
    """In place; foreign keys, indexes and defaults follow."""
    op.execute(f"ALTER TABLE {table} RENAME COLUMN {column} TO {named}")


def name_reference(table: str, column: str, named: str) -> None:
    """Name the index and the foreign key of a renamed column that holds a blob's sha256 after it."""
    op.drop_index(op.f(f"ix_{table}_{column}"), table_name=table)
    op.create_index(op.f(f"ix_{table}_{named}"), table, [named], unique=False)
    triggers = _sqlite_triggers(table)
    with op.batch_alter_table(table) as changed:
        changed.drop_constraint(op.f(f"fk_{table}_{column}"), type_="foreignkey")
        changed.create_foreign_key(op.f(f"fk_{table}_{named}"), "blobs", [named], ["sha256"])
    for trigger in triggers:
        op.execute(trigger)


def _sqlite_triggers(table: str) -> list[str]:
    """What makes them anew: SQLite drops them with the table that Alembic copies. PostgreSQL keeps its own."""
    if op.get_bind().dialect.name != "sqlite":
        return []
    asked = sa.text("SELECT sql FROM sqlite_master WHERE type = 'trigger' AND tbl_name = :table ORDER BY name")
    return list(op.get_bind().scalars(asked, {"table": table}))
