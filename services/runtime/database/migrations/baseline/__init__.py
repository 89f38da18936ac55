"""The schema of the first release, which revision 0030 creates in an empty database.

**Conventions.** The tables are written out once more beside `services/runtime/orm/`, in modules of the same names: the
ORM follows the newest revision, and these modules never change.
"""

from sqlalchemy import Connection
from sqlalchemy.schema import CreateIndex, CreateTable

from services.runtime.database.migrations.baseline import (  # noqa: F401 - each defines tables
    artefacts,
    benchmarks,
    datasets,
    jobs,
    ledgers,
    notifications,
    people,
    sequences,
    submissions,
)
from services.runtime.database.migrations.baseline.tables import METADATA
from services.runtime.database.migrations.baseline.triggers import create_triggers, drop_functions


def create_schema(connection: Connection) -> None:
    for table in METADATA.sorted_tables:
        connection.execute(CreateTable(table))
        for index in table.info["indexes"]:
            connection.execute(CreateIndex(index))
    create_triggers(connection)


def drop_schema(connection: Connection) -> None:
    METADATA.drop_all(connection, checkfirst=False)  # and the triggers with their tables
    drop_functions(connection)
