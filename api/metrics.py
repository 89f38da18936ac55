"""What the platform tells Prometheus: requests as they end; jobs, uploads and queues as they are when it asks.

**Conventions.** Names begin with `stone_` and end in their unit. Labels take few values: methods, route templates,
statuses, queues, states; never an id or a name. Each application has a registry of its own.
"""

from collections.abc import Iterator

import structlog
from prometheus_client import CollectorRegistry, Counter, Histogram, generate_latest
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector
from redis import RedisError
from sqlalchemy import func, select

from services.runtime.bell import waiting
from services.runtime.celery_app import QUEUES
from services.runtime.orm import Job, Upload
from services.runtime.platform import Platform

METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS")
BUCKETS_S = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 60.0)

log = structlog.get_logger(__name__)


class Meters:
    """Counts requests; `exposition()` is the text that Prometheus reads."""

    def __init__(self, platform: Platform) -> None:
        self._registry = CollectorRegistry()
        self._requests = Counter(
            "stone_requests", "Requests answered", ("method", "route", "status"), registry=self._registry
        )
        self._lasted = Histogram(
            "stone_request_seconds",
            "How long an answer took",
            ("method", "route"),
            buckets=BUCKETS_S,
            registry=self._registry,
        )
        self._registry.register(_Work(platform))

    def note(self, method: str, route: str, status: int, lasted_s: float) -> None:
        known = method if method in METHODS else "other"
        self._requests.labels(known, route, str(status)).inc()
        self._lasted.labels(known, route).observe(lasted_s)

    def exposition(self) -> bytes:
        """Raises SQLAlchemy's `OperationalError` when the database is away."""
        return generate_latest(self._registry)


class _Work(Collector):
    """Counts jobs, uploads and bells when asked."""

    def __init__(self, platform: Platform) -> None:
        self._platform = platform
        self._waiting = waiting(platform.settings)

    def describe(self) -> Iterator[GaugeMetricFamily]:
        """Nothing: registering must not read the database."""
        yield from ()

    def collect(self) -> Iterator[GaugeMetricFamily]:
        with self._platform.database.reading() as session:
            counted = select(Job.queue, Job.state, func.count()).where(Job.queue != "").group_by(Job.queue, Job.state)
            jobs = session.execute(counted).all()
            under_way = session.scalar(select(func.count()).select_from(Upload).where(Upload.state == "open")) or 0
        family = GaugeMetricFamily("stone_jobs", "Jobs by queue and state", labels=("queue", "state"))
        for queue, state, count in jobs:
            family.add_metric((queue, state), count)
        yield family
        yield GaugeMetricFamily("stone_uploads_open", "Uploads under way", under_way)
        yield from self._bells()

    def _bells(self) -> Iterator[GaugeMetricFamily]:
        family = GaugeMetricFamily("stone_queue_bells", "Bells not yet heard, by queue", labels=("queue",))
        is_up = True
        try:
            for queue in QUEUES:
                family.add_metric((queue,), self._waiting(queue))
        except (RedisError, OSError) as error:
            log.warning("broker away", reason=str(error))
            is_up = False
        yield family
        yield GaugeMetricFamily("stone_broker_up", "Whether the broker answers", float(is_up))
