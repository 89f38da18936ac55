"""Column defaults that record the span and request a row was made in.

**Conventions.** A request's id is bound to the context of the log; an attempt binds that of the job it runs, so that
what it queues has it too. A traceparent is that of W3C Trace Context, `00-<32 hex>-<16 hex>-<2 hex>`; empty: none.
"""

from opentelemetry.context import Context
from opentelemetry.trace import get_current_span
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator
from structlog.contextvars import get_contextvars

LONGEST_REQUEST_ID = 64
# By name, since rows outlive what OTEL_PROPAGATORS says.
W3C = TraceContextTextMapPropagator()


def origin_trace() -> str:
    """The traceparent of the span that this is done in; empty outside of one."""
    carrier: dict[str, str] = {}
    W3C.inject(carrier)
    return carrier.get("traceparent", "")


def origin_request() -> str:
    """The id of the request that this is done for; empty where none asked."""
    return str(get_contextvars().get("request_id", ""))[:LONGEST_REQUEST_ID]


def context_of(traceparent: str) -> Context | None:
    """To make a span within the one of `traceparent`; None where that is none."""
    found = W3C.extract({"traceparent": traceparent}, Context())
    return found if get_current_span(found).get_span_context().is_valid else None


def link_to(traceparent: str) -> None:
    """What is done now has to do with that span; nothing happens without either."""
    span = get_current_span()
    other = context_of(traceparent) if span.is_recording() else None
    if other is not None:
        span.add_link(get_current_span(other).get_span_context())
