"""Routes that answer with some rows: a few threads work on them, and who came first is answered first.

**Conventions.** Threads of one process run Python one at a time, so more of them answer no sooner: forty, which is what
other routes have, take the interpreter from each other in any order, some requests wait five times as long as others,
and each taking costs. What may last, say for a file or a board that is computed, has no place here: it would hold up
the lists.
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
    """The route's function as one that is awaited while one of the few threads runs it."""

    @wraps(answer)
    async def answered(*args: P.args, **given: P.kwargs) -> Response:
        return await to_thread.run_sync(partial(answer, *args, **given), limiter=_row_readers())

    return answered


def _row_readers() -> CapacityLimiter:
    """Those of the running event loop."""
    limiter = _limiter.get(None)
    if limiter is None:
        limiter = CapacityLimiter(ROW_READERS)
        _limiter.set(limiter)
    return limiter
