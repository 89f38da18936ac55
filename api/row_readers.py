"""Routes that return rows: a few threads run them in the order of arrival.

**Conventions.** Threads of one process run Python one at a time, so more threads answer no sooner. The forty threads of
other routes contend for the interpreter at a cost, and some requests then wait five times as long as others. Slow work,
such as reading files or computing boards, must not run here, because it would delay the lists.
"""

from collections.abc import Callable, Coroutine
from functools import partial, wraps
from typing import Any, ParamSpec

from anyio import CapacityLimiter, to_thread
from anyio.lowlevel import RunVar
from starlette.responses import Response

from services.runtime.database.transactions import ROW_READERS

P = ParamSpec("P")
_limiter = RunVar[CapacityLimiter]("row_readers")


def by_row_readers(answer: Callable[P, Response]) -> Callable[P, Coroutine[Any, Any, Response]]:
    """Return the route's function as a coroutine function that runs in one of the few threads."""

    @wraps(answer)
    async def answered(*args: P.args, **given: P.kwargs) -> Response:
        return await to_thread.run_sync(partial(answer, *args, **given), limiter=_row_readers())

    return answered


def _row_readers() -> CapacityLimiter:
    """Return the limiter of the running event loop."""
    limiter = _limiter.get(None)
    if limiter is None:
        limiter = CapacityLimiter(ROW_READERS)
        _limiter.set(limiter)
    return limiter
