"""Every list, board, claim and chore finds its answer by an index: PostgreSQL says so, with whole tables made dear.

The rows are those of `benchmarks.rows`, where the same questions meet a million sequences.
"""

from collections.abc import Iterator
from random import Random

import pytest

from benchmarks.rows.bulk_inserts import analyse, prepare
from benchmarks.rows.kinds import Amounts, fill
from benchmarks.rows.plans import Statement, StatementPlan, explained, large_tables, record_statements
from benchmarks.rows.queries import Kit, Question, people_of, questions
from services.runtime.database.transactions import Database
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings, DatabaseSettings
from testing.api.serving import client_of
from testing.servers.fixtures import make_settings, opened
from testing.servers.postgres import PostgresServer

SMALL = Amounts(sequences=2400, submissions=1500, backlog=300, members=1200)
LARGE_ROWS = 1100


@pytest.fixture(scope="module")
def kit(
    postgres_server: PostgresServer, _postgres_template: str, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Kit]:
    """A platform on PostgreSQL with some thousand rows of everything."""
    with postgres_server.fresh_database(_postgres_template) as url:
        settings = make_settings(
            tmp_path_factory.mktemp("rows"), database=DatabaseSettings(url), api=ApiSettings(requests_per_minute=10**6)
        )
        platform = opened(settings, [])
        _lay(platform.database)
        with client_of(platform) as client:
            yield Kit(platform, client, people_of(platform), SMALL)
        platform.database.close()


def _lay(database: Database) -> None:
    with database.engine.connect() as opened_connection:
        connection = opened_connection.execution_options(isolation_level="AUTOCOMMIT")
        prepare(connection)
        fill(connection, SMALL)
        analyse(connection)


def plans_of(platform: Platform, statements: list[Statement]) -> list[StatementPlan]:
    with platform.database.engine.connect() as connection:
        connection.exec_driver_sql("SET LOCAL enable_seqscan = off")
        large = large_tables(connection, LARGE_ROWS)
        wanted = {statement.sql: statement for statement in statements if statement.is_explained}
        return [explained(connection, one, large, is_run=False) for one in wanted.values()]


@pytest.mark.parametrize("question", [one for one in questions() if not one.bound], ids=lambda one: one.name)
def test_nothing_large_is_read_whole(kit: Kit, question: Question) -> None:
    with record_statements(kit.platform.database.engine) as statements:
        question.ask(kit, Random(1))
    plans = plans_of(kit.platform, statements)
    assert plans, "nothing was asked of the database"
    assert {plan.sql: plan.faults for plan in plans if plan.faults} == {}


def test_a_statement_without_an_index_is_found_out(kit: Kit) -> None:
    unindexed = Statement("SELECT * FROM jobs WHERE failure_code = %(code)s", {"code": "x"})
    ordered = Statement("SELECT id FROM jobs ORDER BY id", None)
    assert [plan.faults for plan in plans_of(kit.platform, [unindexed])] == [("reads all of jobs",)]
    assert [plan.faults for plan in plans_of(kit.platform, [ordered])] == [("reads all of pk_jobs",)]
