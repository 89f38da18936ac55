"""What the platform tells Prometheus: what all its processes counted, and how things stand when it asks.

**Conventions.** Labels take few values: methods, route templates, statuses, queues, kinds; never an id or a name. Each
application counts for itself and, with `tell_on`, lets the others know. What is shown is what was told, and only that:
whichever process is asked, a count never falls, which Prometheus would take for a beginning anew. So with the database
away there are no counts, but a line that says so. Names and units: `metric_families.py`.
"""

import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import gettempdir
from threading import Lock, Thread

import structlog
from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from redis import RedisError
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.pool import QueuePool

from api.metric_families import counted, standings
from services.runtime.bell import waiting
from services.runtime.celery_app import QUEUES
from services.runtime.platform import Platform
from services.runtime.telemetry.meters import REQUEST_BYTES, REQUEST_SECONDS, REQUESTS
from services.runtime.telemetry.standing import standing
from services.runtime.telemetry.tallies import Counts, Tallies, summed, tallies
from services.runtime.telemetry.tally_rows import TallyRow, told_by_all
from services.runtime.usage import disk

METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS")
TELL_S = 5.0

log = structlog.get_logger(__name__)


class Meters:
    """Counts requests; `exposition()` is the text that Prometheus reads."""

    def __init__(self, platform: Platform) -> None:
        self._platform = platform
        self._tallies = Tallies()
        self._row = TallyRow(self._tallies, tallies())
        self._telling, self._is_heard = Lock(), False
        self._registry = CollectorRegistry()
        ProcessCollector(registry=self._registry)
        self._registry.register(_Collected(platform, self))

    def note(self, method: str, route: str, status: int, lasted_s: float) -> None:
        known = method if method in METHODS else "other"
        self._tallies.add(REQUESTS, (known, route, str(status)))
        self._tallies.observe(REQUEST_SECONDS, (known, route), lasted_s)

    def note_bytes(self, came: int, went: int) -> None:
        """Bytes of the bodies of a request and of its answer."""
        self._tallies.add(REQUEST_BYTES, ("in",), came)
        self._tallies.add(REQUEST_BYTES, ("out",), went)

    def tell_on(self) -> None:
        """From now on tell the other processes every `TELL_S`, by a thread."""
        self._is_heard = True
        Thread(target=self._tell_on, name="counts", daemon=True).start()

    def tell(self) -> None:
        """Tell once. Raises `SQLAlchemyError` when the database is away."""
        with self._telling:
            with self._platform.database.transaction() as session:
                committed = self._row.tell(session)
            committed()

    def exposition(self) -> bytes:
        return generate_latest(self._registry)

    def families(self) -> Iterator[Metric]:
        """Counts and standings; of an application that tells nobody its own are added."""
        heartbeat_s = self._platform.settings.jobs.heartbeat_s
        own: Counts = {} if self._is_heard else self._row.counted()
        try:
            with self._platform.database.reading() as session:
                counts, now = summed((told_by_all(session), own)), standing(session, heartbeat_s)
        except SQLAlchemyError as error:
            log.warning("database away", reason=str(error)[:200])
            yield GaugeMetricFamily("stone_database_up", "Whether the database answers", 0.0)
            return
        yield from counted(counts)
        yield from standings(now)
        yield GaugeMetricFamily("stone_database_up", "Whether the database answers", 1.0)

    def _tell_on(self) -> None:
        while True:
            time.sleep(TELL_S)
            try:
                self.tell()
            except SQLAlchemyError as error:
                log.warning("counts not told; they will be", reason=str(error)[:200])


class _Collected(Collector):
    """Asked when Prometheus asks."""

    def __init__(self, platform: Platform, meters: Meters) -> None:
        self._platform, self._meters = platform, meters
        self._waiting = waiting(platform.settings)

    def describe(self) -> Iterator[Metric]:
        """Nothing: registering must not read the database."""
        yield from ()

    def collect(self) -> Iterator[Metric]:
        yield from self._connections()  # before this very question takes one
        yield from self._meters.families()
        yield from self._bells()
        yield from self._disks()

    def _connections(self) -> Iterator[Metric]:
        pool = self._platform.database.engine.pool
        if not isinstance(pool, QueuePool):
            return
        family = GaugeMetricFamily("stone_database_connections", "Of this process, by use", labels=("state",))
        family.add_metric(("in_use",), pool.checkedout())
        family.add_metric(("idle",), pool.checkedin())
        yield family
        yield GaugeMetricFamily("stone_database_pool_connections", "Connections that are kept open", pool.size())

    def _disks(self) -> Iterator[Metric]:
        free = GaugeMetricFamily("stone_disk_free_bytes", "Free disk of this process's folders", labels=("place",))
        size = GaugeMetricFamily("stone_disk_bytes", "Size of the disks they are on", labels=("place",))
        for place, folder in (("data", self._platform.settings.root), ("scratch", Path(gettempdir()))):
            room = disk(folder)
            if room.free_bytes is not None and room.total_bytes is not None:
                free.add_metric((place,), room.free_bytes)
                size.add_metric((place,), room.total_bytes)
        yield free
        yield size

    def _bells(self) -> Iterator[Metric]:
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
