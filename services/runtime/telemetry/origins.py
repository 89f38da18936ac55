"""Where a row comes from: the span and the request that it was made in, as defaults of columns.

**Conventions.** A request's id is bound to the context of the log; an attempt binds that of the job it runs, so that
what it queues has it too.
"""

from structlog.contextvars import get_contextvars

from services.runtime.telemetry.tracing import current_traceparent

LONGEST_REQUEST_ID = 64


def origin_trace() -> str:
    """The traceparent of the span that this is done in; empty outside of one."""
    return current_traceparent()


def origin_request() -> str:
    """The id of the request that this is done for; empty where none asked."""
    return str(get_contextvars().get("request_id", ""))[:LONGEST_REQUEST_ID]
