"""Tracing by OpenTelemetry (OTLP over HTTP), loaded only when its environment variables are set.

**Conventions.** Entry points call `setup_tracing` after the last fork. Without this call (tests, tools) spans are the
API's no-ops and the SDK is not loaded. Tracing is on if `OTEL_EXPORTER_OTLP_ENDPOINT` (or `…_TRACES_ENDPOINT`) is set
or `OTEL_TRACES_EXPORTER` is `otlp`; `OTEL_SDK_DISABLED=true` and `OTEL_TRACES_EXPORTER=none` disable it. The SDK's
variables set sampling, batching, headers and limits. OpenTelemetry's global provider stays unset: libraries with
tracing of their own would send paths, queries and statements through it.
"""

import atexit
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from threading import Lock, Thread

from opentelemetry.context import Context, get_current
from opentelemetry.trace import INVALID_SPAN, NoOpTracer, Span, SpanKind, StatusCode, Tracer, get_current_span
from opentelemetry.util.types import AttributeValue
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.orm import Job, RecordingFile, Upload
from services.runtime.telemetry.origins import link_to

ENDPOINTS = ("OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT")
CLOSED_WITHIN_S = 3.0

_OFF = NoOpTracer()
_OPENED: list[tuple[Tracer, Callable[[], None]]] = []


def is_asked_for(environment: Mapping[str, str] = os.environ) -> bool:
    """Return whether the variables enable tracing."""
    if environment.get("OTEL_SDK_DISABLED", "").strip().lower() == "true":
        return False
    exporter = environment.get("OTEL_TRACES_EXPORTER", "").strip()
    if exporter:
        return exporter == "otlp"
    return any(environment.get(name, "").strip() for name in ENDPOINTS)


def setup_tracing(service: str) -> None:
    """If tracing is enabled, send this process's spans as `OTEL_SERVICE_NAME`, or by default as `service`."""
    if _OPENED or not is_asked_for():
        return
    from services.runtime.telemetry.otlp import provider_of  # the import takes a sixth of a second

    provider = provider_of(service)
    _OPENED.append((provider.get_tracer("stone"), provider.shutdown))
    atexit.register(close_tracing)


def close_tracing() -> None:
    """Send all ended spans; an unreachable collector delays this only briefly."""
    while _OPENED:
        _, shutdown = _OPENED.pop()
        closing = Thread(target=shutdown, name="tracing", daemon=True)
        closing.start()
        closing.join(CLOSED_WITHIN_S)


def tracer() -> Tracer:
    """Return this process's tracer, or OpenTelemetry's no-op if tracing is off."""
    return _OPENED[0][0] if _OPENED else _OFF


@contextmanager
def span(
    name: str,
    kind: SpanKind = SpanKind.INTERNAL,
    *,
    within: Context | None = None,
    attributes: Mapping[str, AttributeValue] | None = None,
) -> Iterator[Span]:
    """Open a span (`with span(…) as current:`). An exception leaves its class in the span, never its message.

    `within` comes from `origins.context_of`; None continues the current span. Attributes are ids, kinds, codes and
    numbers.
    """
    with tracer().start_as_current_span(
        name, within, kind, attributes, record_exception=False, set_status_on_exception=False
    ) as made:
        try:
            yield made
        except Exception as error:
            mark_failed(made, type(error).__name__)
            raise


def mark_failed(span: Span, code: str) -> None:
    """Mark the span as failed with this code."""
    span.set_attribute("error.type", code)
    span.set_status(StatusCode.ERROR)


# Links between traces of consecutive user actions, which may be hours apart.
#
#     upload ← recording (register) ← processing (synchronise, label) ← export;  upload ← submission (open, part, join)
#
# **Conventions.** A trace is one act of a person with all the jobs it caused; a link leads back to the previous act.
# The database is queried only if the span is sent.


def link_uploads_of(session: Session, recording_id: str) -> None:
    """Link the current span to the uploads of this recording's files."""
    if get_current_span().is_recording():
        of_recording = RecordingFile.recording_id == recording_id
        sent = select(Upload.traceparent).join(RecordingFile, RecordingFile.upload_id == Upload.id)
        for traceparent in session.scalars(sent.where(of_recording)):
            link_to(traceparent)


def link_job(session: Session, job_id: str) -> None:
    """Link the current span to the job, or run, that produced its inputs."""
    if get_current_span().is_recording():
        link_to(session.scalar(select(Job.traceparent).where(Job.id == job_id)) or "")


# The stages of an attempt as child spans, each ended by the next.


class StageSpans:
    """Stage spans within the span that is current at construction; any thread may enter a stage."""

    def __init__(self) -> None:
        self._within = get_current()
        self._name, self._lock = "", Lock()
        self._span: Span = INVALID_SPAN

    def enter(self, name: str) -> None:
        """End the current stage and start the stage `name`; an empty name starts none."""
        if name == self._name or not get_current_span(self._within).is_recording():
            return
        with self._lock:
            self._span.end()
            self._span = tracer().start_span(name, self._within) if name else INVALID_SPAN
            self._name = name
