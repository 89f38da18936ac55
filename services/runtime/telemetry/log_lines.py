"""Structured logging: one JSON object per line.

**Conventions.** Our lines (structlog) and those of libraries (logging) go to stderr in the same shape. Every line
contains the ids bound to the context (`request_id`; in an attempt also `job_id`, `run_id`, `kind`, `attempt`), and
within a span `trace_id` and `span_id`. Only entry points call `speak_json()`; tests and tools keep their own logging.
"""

import logging
import sys

import structlog
from opentelemetry.trace import format_span_id, format_trace_id, get_current_span
from structlog.types import EventDict, Processor

LIBRARIES = ("uvicorn", "uvicorn.error")
SILENT = ("uvicorn.access",)
"""Libraries whose lines contain whole queries; ours (`api/middleware/entry.py`) have the same facts without them."""


def name_span(_logger: object, _method: str, line: EventDict) -> EventDict:
    """Add the current trace and span to the line, if there is a span."""
    context = get_current_span().get_span_context()
    if context.is_valid:
        line.update(trace_id=format_trace_id(context.trace_id), span_id=format_span_id(context.span_id))
    return line


_SHARED: tuple[Processor, ...] = (
    structlog.contextvars.merge_contextvars,
    name_span,
    structlog.stdlib.add_logger_name,
    structlog.stdlib.add_log_level,
    structlog.processors.TimeStamper(fmt="iso", utc=True),
    # Without local variables, which may be secrets.
    structlog.processors.ExceptionRenderer(structlog.tracebacks.ExceptionDictTransformer(show_locals=False)),
)


def speak_json(level: int = logging.INFO) -> None:
    """Log JSON lines from `level` upwards in this process. A second call changes nothing."""
    structlog.configure(
        processors=[structlog.stdlib.filter_by_level, *_SHARED, structlog.stdlib.ProcessorFormatter.wrap_for_formatter],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.stdlib.BoundLogger,
        cache_logger_on_first_use=False,
    )
    finish: list[Processor] = [
        structlog.stdlib.ProcessorFormatter.remove_processors_meta,
        structlog.processors.JSONRenderer(default=repr),
    ]
    lines = logging.StreamHandler(sys.stderr)
    lines.setFormatter(structlog.stdlib.ProcessorFormatter(foreign_pre_chain=list(_SHARED), processors=finish))
    logging.root.handlers[:] = [lines]
    logging.root.setLevel(level)
    for name in LIBRARIES:
        logger = logging.getLogger(name)
        logger.handlers.clear()
        logger.propagate = True
    for name in SILENT:
        logger = logging.getLogger(name)
        logger.handlers.clear()
        logger.propagate = False  # uvicorn checks for handlers, also of parents
