"""The Alembic environment: runs revisions on the given connection, else on the configured database.

**Conventions.** The transaction belongs to the creator of the connection, so that an upgrade is atomic.
"""

from alembic import context
from sqlalchemy import Connection

from services.runtime.database.migrate import schema_connection
from services.runtime.orm import Base
from services.runtime.settings import Settings


def run_on(connection: Connection) -> None:
    """Run the requested revisions, in the connection's transaction."""
    context.configure(connection=connection, target_metadata=Base.metadata, render_as_batch=True)
    context.run_migrations()


if "connection" in context.config.attributes:
    run_on(context.config.attributes["connection"])
else:
    with schema_connection(Settings()) as fresh:
        run_on(fresh)
