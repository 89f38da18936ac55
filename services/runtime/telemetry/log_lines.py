"""Structured logging: one JSON object per line.

**Conventions.** Everything goes to stderr, ours (structlog) and what libraries say (logging) in the same shape. What is
bound to the context (`request_id`; of an attempt `job_id`, `run_id`, `kind`, `attempt` too) is in every line, and
`trace_id` and `span_id` where there is a span. `speak_json()` is for entry points; tests and tools are left alone.
"""

import logging
import sys

import structlog
from opentelemetry.trace import format_span_id, format_trace_id, get_current_span
from structlog.types import EventDict, Processor

LIBRARIES = ("uvicorn", "uvicorn.error")
SILENT = ("uvicorn.access",)
"""Its lines have whole queries; ours (`api/middleware/entry.py`) say the same without."""


def name_span(_logger: object, _method: str, line: EventDict) -> EventDict:
    """Which span and trace the line was said in; nothing outside of one."""
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
    """Let this process say what it says as JSON lines, from `level` upwards. A second call changes nothing more."""
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
    for name in LIBRARIES:  # these bring handlers of their own
        logger = logging.getLogger(name)
        logger.handlers.clear()
        logger.propagate = True
    for name in SILENT:
        logger = logging.getLogger(name)
        logger.handlers.clear()
        logger.propagate = False  # uvicorn asks whether anybody would hear, and a parent would
