"""Spans that have ended go to the collector in batches, by a thread of their own.

**Conventions.** The SDK's own batching starts its thread again in every forked child, so in those that are confined to
read strangers' files too; here a child of a fork sends nothing. Delay and sizes are those of the SDK's variables.
Whoever ends a span waits for nobody: what finds the queue full is dropped, and the log says so once in a while.
"""

import os
from collections import deque
from threading import Event, Lock, Thread

import structlog
from opentelemetry.context import Context
from opentelemetry.sdk.trace import ReadableSpan, Span, SpanProcessor
from opentelemetry.sdk.trace.export import SpanExporter

log = structlog.get_logger(__name__)


class Sender(SpanProcessor):
    """`Sender(exporter)`; `shutdown()` sends the rest, for as long as the exporter tries."""

    def __init__(self, exporter: SpanExporter) -> None:
        self._exporter = exporter
        self._delay_s = _number("OTEL_BSP_SCHEDULE_DELAY", 5000) / 1e3
        self._most = _number("OTEL_BSP_MAX_QUEUE_SIZE", 2048)
        self._batch = min(_number("OTEL_BSP_MAX_EXPORT_BATCH_SIZE", 512), self._most)
        self._ended = deque[ReadableSpan]()
        self._dropped = 0
        self._pid = os.getpid()
        self._wake, self._is_over, self._sending = Event(), False, Lock()
        self._thread = Thread(target=self._send_on, name="spans", daemon=True)
        self._thread.start()

    def on_start(self, span: Span, parent_context: Context | None = None) -> None:
        """Nothing to do."""

    def on_end(self, span: ReadableSpan) -> None:
        if not span.context.trace_flags.sampled or self._is_over or os.getpid() != self._pid:
            return
        if len(self._ended) >= self._most:
            self._dropped += 1
            return
        self._ended.append(span)
        if len(self._ended) >= self._batch:
            self._wake.set()

    def shutdown(self) -> None:
        self._is_over = True
        self._wake.set()
        if os.getpid() == self._pid:
            self._thread.join()
        self._exporter.shutdown()

    def force_flush(self, timeout_millis: int = 30000) -> bool:
        self._send()
        return True

    def _send_on(self) -> None:
        while not self._is_over:
            self._wake.wait(self._delay_s)
            self._wake.clear()
            self._send()
        self._send()

    def _send(self) -> None:
        with self._sending:
            while self._ended:
                count = min(self._batch, len(self._ended))
                self._exporter.export([self._ended.popleft() for _ in range(count)])
        if self._dropped:
            log.warning("spans dropped; the collector is away or slow", spans=self._dropped)
            self._dropped = 0


def _number(name: str, default: int) -> int:
    text = os.environ.get(name, "")
    return max(1, int(text)) if text.isdecimal() else default
