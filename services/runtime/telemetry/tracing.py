"""Spans by OpenTelemetry, sent by OTLP over HTTP; switched on by its own variables, and not even loaded before.

**Conventions.** `open_tracing` is for entry points, after the last fork; what calls it not (tests, tools) has no spans.
It is on when `OTEL_EXPORTER_OTLP_ENDPOINT` (or `…_TRACES_ENDPOINT`) is set or `OTEL_TRACES_EXPORTER` is `otlp`;
`OTEL_SDK_DISABLED=true` and `OTEL_TRACES_EXPORTER=none` switch it off. Sampling, batching, headers and limits are those
of the SDK's variables. A traceparent is that of W3C Trace Context: `00-<32 hex>-<16 hex>-<2 hex>`; empty without one.
"""

import atexit
import os
import re
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from threading import Lock, Thread
from typing import Protocol

import structlog

ENDPOINTS = ("OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT")
CLOSED_WITHIN_S = 3.0
TRACEPARENT = re.compile(r"00-(?!0{32})[0-9a-f]{32}-(?!0{16})[0-9a-f]{16}-[0-9a-f]{2}")

Fact = str | int | float | bool

log = structlog.get_logger(__name__)


class Traced(Protocol):
    """A span under way, or nothing of the kind. An exception leaves its class behind, never its words."""

    def rename(self, name: str) -> None: ...

    def note(self, facts: Mapping[str, Fact]) -> None:
        """Set attributes: ids, kinds, codes and numbers."""
        ...

    def link(self, traceparent: str) -> None:
        """It has to do with that span; nothing happens for what is none."""
        ...

    def fault(self, code: str) -> None:
        """It ended badly, with this code."""
        ...


class Spans(Protocol):
    """Where spans come from: the seam to OpenTelemetry (`otlp.py`)."""

    def span(self, spec: "SpanSpec") -> AbstractContextManager[Traced]: ...

    def begin(self, name: str, parent: str) -> Callable[[], None]:
        """A span within `parent` that is not made the current one; what ends it."""
        ...

    def current(self) -> Traced | None: ...

    def traceparent(self) -> str: ...

    def close(self) -> None: ...


class _Nothing:
    """What there is without tracing."""

    def rename(self, name: str) -> None:
        pass

    def note(self, facts: Mapping[str, Fact]) -> None:
        pass

    def link(self, traceparent: str) -> None:
        pass

    def fault(self, code: str) -> None:
        pass


def _nothing_to_end() -> None:
    pass


NOTHING: Traced = _Nothing()
_IN_NOTHING = nullcontext(NOTHING)
_OPENED: list[Spans] = []


def is_asked_for(environment: Mapping[str, str] = os.environ) -> bool:
    """Whether the variables switch tracing on."""
    if environment.get("OTEL_SDK_DISABLED", "").strip().lower() == "true":
        return False
    exporter = environment.get("OTEL_TRACES_EXPORTER", "").strip()
    if exporter:
        return exporter == "otlp"
    return any(environment.get(name, "").strip() for name in ENDPOINTS)


def open_tracing(service: str) -> None:
    """Send this process's spans from now on, if that is asked for, as `OTEL_SERVICE_NAME` or else as `service`."""
    if _OPENED or not is_asked_for():
        return
    from services.runtime.telemetry.otlp import OtlpSpans  # a third of a second and 15 MB: only for who wants it

    _OPENED.append(OtlpSpans(service))
    atexit.register(close_tracing)


def close_tracing() -> None:
    """Send what has ended and is not sent; a collector that is away holds nobody up for long."""
    while _OPENED:
        closing = Thread(target=_OPENED.pop().close, name="tracing", daemon=True)
        closing.start()
        closing.join(CLOSED_WITHIN_S)


def is_tracing() -> bool:
    return bool(_OPENED)


@dataclass(frozen=True)
class SpanSpec:
    """A span to be, within `parent` or, where that is none, the current one; `kind`: internal, server, consumer."""

    name: str
    kind: str = "internal"
    parent: str = ""
    facts: Mapping[str, Fact] = field(default_factory=dict)


def span(spec: SpanSpec) -> AbstractContextManager[Traced]:
    """`with span(SpanSpec(…)) as traced:`."""
    return _OPENED[0].span(spec) if _OPENED else _IN_NOTHING


class Steps:
    """The stages of an attempt as spans within the current one, each ended by the next; any thread may enter them."""

    def __init__(self) -> None:
        self._parent = current_traceparent()
        self._name, self._lock = "", Lock()
        self._end: Callable[[], None] = _nothing_to_end

    def enter(self, name: str) -> None:
        """From now on it is at `name`, until another is entered."""
        if not self._parent or name == self._name:
            return
        with self._lock:
            self._end()
            self._end = _OPENED[0].begin(name, self._parent) if _OPENED and name else _nothing_to_end
            self._name = name


def current_traceparent() -> str:
    return _OPENED[0].traceparent() if _OPENED else ""


def current_ids() -> Mapping[str, str]:
    """`trace_id` and `span_id` for a line of a log; nothing outside of a span."""
    parts = current_traceparent().split("-")
    return {"trace_id": parts[1], "span_id": parts[2]} if len(parts) == len("vtsf") else {}


def link(traceparent: str) -> None:
    """What is done now has to do with that span; nothing happens without either."""
    traced = _OPENED[0].current() if _OPENED and traceparent else None
    if traced is not None:
        traced.link(traceparent)
