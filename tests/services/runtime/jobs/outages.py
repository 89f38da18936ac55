"""A database that fails as real ones do: answers that are lost after the commit, and times when it is away."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import pytest
from sqlalchemy.exc import OperationalError

from services.runtime.database.transactions import Database
from services.runtime.platform import Platform


def quick(platform: Platform, **limits: float) -> Platform:
    """The platform, whose attempts speak often."""
    jobs = replace(platform.settings.jobs, progress_s=0.01, heartbeat_s=0.02, **limits)  # type: ignore[arg-type]
    return replace(platform, settings=platform.settings.model_copy(update={"jobs": jobs}))


class LostAnswers:
    """`after(n)`: the n-th commit from now on reaches the database, and its answer reaches nobody."""

    def __init__(self, platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
        dialect = platform.database.engine.dialect
        self._commit, self._error = dialect.do_commit, dialect.loaded_dbapi.OperationalError
        self._left = 0
        monkeypatch.setattr(dialect, "do_commit", self._commit_unheard)

    @property
    def is_armed(self) -> bool:
        return self._left > 0

    def after(self, commits: int) -> None:
        self._left = commits

    def _commit_unheard(self, connection: Any) -> None:
        self._commit(connection)
        if self._left:
            self._left -= 1
            if not self._left:
                raise self._error("server closed the connection unexpectedly")


class Away:
    """While `error` is set, every transaction for writing raises it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.error: Exception | None = None
        self.refused = 0
        begin = Database.transaction

        @contextmanager
        def transaction(database: Database) -> Iterator[Any]:
            if self.error is not None:
                self.refused += 1
                raise self.error
            with begin(database) as session:
                yield session

        monkeypatch.setattr(Database, "transaction", transaction)


GONE = OperationalError("BEGIN", {}, OSError("connection refused"))
