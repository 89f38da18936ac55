"""The OpenTelemetry SDK exporter (OTLP over HTTP), imported only when tracing is enabled.

**Conventions.** What the collector refuses or does not hear is dropped by the SDK with a line in the log; work never
waits for it. The SDK's batching begins again in every forked child, so in those that are confined to read strangers'
files too, where a thread from before the fences would stand outside of them: here it is ended before the child does
anything, and a child of a fork sends nothing.
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
    """Sends for the process that made it; a child of a fork lets go without touching the parent's connections."""

    def __init__(self) -> None:
        super().__init__()
        self._made_in = os.getpid()

    def shutdown(self) -> None:
        if os.getpid() == self._made_in:
            super().shutdown()  # type: ignore[no-untyped-call]


def provider_of(service: str) -> TracerProvider:
    """As the variables say, which also may name the service otherwise."""
    logging.getLogger("opentelemetry").setLevel(logging.WARNING)  # it tells of every span that ends after the end
    named = {} if os.environ.get("OTEL_SERVICE_NAME") else {SERVICE_NAME: service}
    provider = TracerProvider(resource=Resource.create(named), shutdown_on_exit=False)
    batches = BatchSpanProcessor(OwnProcessExporter())
    provider.add_span_processor(batches)
    _end_in_children(batches)
    return provider


def _end_in_children(batches: BatchSpanProcessor) -> None:
    """Registered after the SDK's own hook, so called after it: the thread that it has begun again is joined here."""
    ending = WeakMethod(batches.shutdown)

    def end() -> None:
        shutdown = ending()
        if shutdown is not None:
            shutdown()  # type: ignore[no-untyped-call]
            _await_one_thread()

    os.register_at_fork(after_in_child=end)


def _await_one_thread(patience_s: float = 1.0) -> None:
    """A thread that was joined may still be on its way out of the kernel, and fences are raised around one thread."""
    until_s = time.monotonic() + patience_s
    while len(os.listdir(THREADS)) > 1 and time.monotonic() < until_s:
        time.sleep(1e-4)
