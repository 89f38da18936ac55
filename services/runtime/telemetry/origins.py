"""Column defaults that record the span and request a row was created in.

**Conventions.** The log context contains the request's id. An attempt binds the id of its job's request, so jobs that
it queues inherit the id. A traceparent follows W3C Trace Context, `00-<32 hex>-<16 hex>-<2 hex>`; it is empty outside
of a span.
"""

from opentelemetry.context import Context
from opentelemetry.trace import get_current_span
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator
from structlog.contextvars import get_contextvars

LONGEST_REQUEST_ID = 64
# A fixed format, since rows outlive the setting of OTEL_PROPAGATORS.
W3C = TraceContextTextMapPropagator()


def origin_trace() -> str:
    """Return the traceparent of the current span; empty outside of a span."""
    carrier: dict[str, str] = {}
    W3C.inject(carrier)
    return carrier.get("traceparent", "")


def origin_request() -> str:
    """Return the id of the current request; empty outside of a request."""
    return str(get_contextvars().get("request_id", ""))[:LONGEST_REQUEST_ID]


def context_of(traceparent: str) -> Context | None:
    """Return a context for spans within the span of `traceparent`; None if it is invalid."""
    context = W3C.extract({"traceparent": traceparent}, Context())
    return context if get_current_span(context).get_span_context().is_valid else None


def link_to(traceparent: str) -> None:
    """Link the current span to that of `traceparent`, if there are both."""
    span = get_current_span()
    other = context_of(traceparent) if span.is_recording() else None
    if other is not None:
        span.add_link(get_current_span(other).get_span_context())
