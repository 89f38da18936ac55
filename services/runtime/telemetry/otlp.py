"""The OpenTelemetry SDK exporter (OTLP over HTTP), imported only when tracing is enabled.

**Conventions.** If the collector refuses spans or is unreachable, the SDK drops them and logs a line; work never waits
for it. The SDK restarts its batching thread in every forked child, including confined children that read untrusted
files, where such a thread would be outside the fences. Here it ends before the child does anything, and a forked child
sends nothing.
"""

import logging
import os
import time
from weakref import WeakMethod

from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import SERVICE_NAME, Resource
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import BatchSpanProcessor

THREADS = "/proc/self/task"


class OwnProcessExporter(OTLPSpanExporter):
    """Send spans of the process that created it; a forked child leaves the parent's connections untouched."""

    def __init__(self) -> None:
        super().__init__()
        self._made_in = os.getpid()

    def shutdown(self) -> None:
        if os.getpid() == self._made_in:
            super().shutdown()  # type: ignore[no-untyped-call]


def provider_of(service: str) -> TracerProvider:
    """Return a provider configured by the OTEL variables, which may override the service name."""
    logging.getLogger("opentelemetry").setLevel(logging.WARNING)  # it logs every span that ends after shutdown
    named = {} if os.environ.get("OTEL_SERVICE_NAME") else {SERVICE_NAME: service}
    provider = TracerProvider(resource=Resource.create(named), shutdown_on_exit=False)
    batches = BatchSpanProcessor(OwnProcessExporter())
    provider.add_span_processor(batches)
    _end_in_children(batches)
    return provider


def _end_in_children(batches: BatchSpanProcessor) -> None:
    """Join the thread that the SDK restarted in a child; registered after the SDK's own hook, so called after it."""
    ending = WeakMethod(batches.shutdown)

    def end() -> None:
        shutdown = ending()
        if shutdown is not None:
            shutdown()  # type: ignore[no-untyped-call]
            _await_one_thread()

    os.register_at_fork(after_in_child=end)


def _await_one_thread(patience_s: float = 1.0) -> None:
    """Wait until the kernel has removed the joined thread: fences require a single thread."""
    until_s = time.monotonic() + patience_s
    while len(os.listdir(THREADS)) > 1 and time.monotonic() < until_s:
        time.sleep(1e-4)
