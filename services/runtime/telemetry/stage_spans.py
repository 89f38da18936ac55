"""The stages of an attempt as spans within the attempt's, each ended by the next."""

from threading import Lock

from opentelemetry.context import get_current
from opentelemetry.trace import INVALID_SPAN, Span, get_current_span

from services.runtime.telemetry.tracing import tracer


class StageSpans:
    """Of the span that is current when this is made; any thread may enter a stage."""

    def __init__(self) -> None:
        self._within = get_current()
        self._name, self._lock = "", Lock()
        self._span: Span = INVALID_SPAN

    def enter(self, name: str) -> None:
        """From now on it is at `name`, until another is entered; empty: at none."""
        if name == self._name or not get_current_span(self._within).is_recording():
            return
        with self._lock:
            self._span.end()
            self._span = tracer().start_span(name, self._within) if name else INVALID_SPAN
            self._name = name
