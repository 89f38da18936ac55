"""Spans made by OpenTelemetry's SDK and sent by OTLP over HTTP. Imported only where tracing is switched on.

**Conventions.** The SDK's own globals are left alone. What the collector refuses or does not hear is dropped by the SDK
with a line in the log; work never waits for it.
"""

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from opentelemetry.context import Context
from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import SERVICE_NAME, Resource
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import SpanExporter
from opentelemetry.trace import (
    NonRecordingSpan,
    Span,
    SpanContext,
    SpanKind,
    StatusCode,
    TraceFlags,
    get_current_span,
    set_span_in_context,
    use_span,
)

from services.runtime.telemetry.sending import Sender
from services.runtime.telemetry.tracing import TRACEPARENT, Fact, SpanSpec, Traced

KINDS = {"internal": SpanKind.INTERNAL, "server": SpanKind.SERVER, "consumer": SpanKind.CONSUMER}


class OtlpSpans:
    """The spans of one process; `exporter` as the variables say unless another is given."""

    def __init__(self, service: str, exporter: SpanExporter | None = None) -> None:
        named = {} if os.environ.get("OTEL_SERVICE_NAME") else {SERVICE_NAME: service}
        self._provider = TracerProvider(resource=Resource.create(named), shutdown_on_exit=False)
        self._provider.add_span_processor(Sender(exporter or OTLPSpanExporter()))
        self._tracer = self._provider.get_tracer("stone")

    @contextmanager
    def span(self, spec: SpanSpec) -> Iterator[Traced]:
        within, kind, facts = _context_of(spec.parent), KINDS[spec.kind], dict(spec.facts)
        begun = self._tracer.start_span(spec.name, within, kind, facts, record_exception=False)
        traced = _Otlp(begun)
        with use_span(begun, end_on_exit=True, record_exception=False, set_status_on_exception=False):
            try:
                yield traced
            except Exception as error:
                traced.fault(type(error).__name__)
                raise

    def begin(self, name: str, parent: str) -> Callable[[], None]:
        return self._tracer.start_span(name, _context_of(parent), record_exception=False).end

    def current(self) -> Traced | None:
        span = get_current_span()
        return _Otlp(span) if span.get_span_context().is_valid else None

    def traceparent(self) -> str:
        context = get_current_span().get_span_context()
        if not context.is_valid:
            return ""
        return f"00-{context.trace_id:032x}-{context.span_id:016x}-{context.trace_flags:02x}"

    def close(self) -> None:
        self._provider.shutdown()


class _Otlp:
    def __init__(self, span: Span) -> None:
        self._span = span

    def rename(self, name: str) -> None:
        self._span.update_name(name)

    def note(self, facts: Mapping[str, Fact]) -> None:
        self._span.set_attributes(dict(facts))

    def link(self, traceparent: str) -> None:
        context = _parsed(traceparent)
        if context is not None:
            self._span.add_link(context)

    def fault(self, code: str) -> None:
        self._span.set_attribute("error.type", code)
        self._span.set_status(StatusCode.ERROR)


def _context_of(parent: str) -> Context | None:
    """None, the current one, where `parent` is no traceparent."""
    context = _parsed(parent)
    return None if context is None else set_span_in_context(NonRecordingSpan(context), Context())


def _parsed(traceparent: str) -> SpanContext | None:
    if not TRACEPARENT.fullmatch(traceparent):
        return None
    _, trace_id, span_id, flags = traceparent.split("-")
    sampled = TraceFlags(int(flags, 16) & TraceFlags.SAMPLED)
    return SpanContext(int(trace_id, 16), int(span_id, 16), is_remote=True, trace_flags=sampled)
