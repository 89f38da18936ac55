"""The Prometheus endpoint: counters of all processes, and the platform's status at scrape time.

**Conventions.** Labels have few values (methods, route templates, statuses, queues, kinds), never an id or a name. Each
application counts for itself and, with `keep_writing`, writes its counts to the database. The endpoint shows the
written counts only, so a count is the same from every process and never falls, which Prometheus would take for a
restart. While the database is unreachable, it shows no counts, and `stone_database_up` is 0.
"""

import time
from collections.abc import Iterable, Iterator, Mapping
from itertools import accumulate, chain
from pathlib import Path
from tempfile import gettempdir
from threading import Lock, Thread

import structlog
from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import Collector
from prometheus_client.utils import floatToGoString
from redis import RedisError
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.pool import QueuePool

from services.runtime.jobs.broker_app import QUEUES
from services.runtime.jobs.wakeup import wake_up_counter
from services.runtime.jobs.worker_presence import WorkerPresence
from services.runtime.platform import Platform
from services.runtime.telemetry.counter_rows import CounterWriter, counters_of_all_processes
from services.runtime.telemetry.counters import (
    BETWEEN,
    METERS,
    RENAMED,
    REQUEST_BYTES,
    REQUEST_SECONDS,
    REQUESTS,
    Counts,
    MetricDefinition,
    ProcessCounters,
    Value,
    process_counters,
    summed,
)
from services.runtime.telemetry.platform_status import MOST, PlatformStatus, platform_status
from services.runtime.telemetry.process_usage import disk
from services.runtime.telemetry.sweeper_statistics import STORED_BLOBS, STORED_BYTES

METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS")
TELL_S = 5.0

log = structlog.get_logger(__name__)


class RequestMetrics:
    """Counts requests; `exposition()` returns the text that Prometheus reads."""

    def __init__(self, platform: Platform) -> None:
        self._platform = platform
        self._counters = ProcessCounters()
        self._row = CounterWriter(self._counters, process_counters())
        self._write_lock, self._is_heard = Lock(), False
        self._registry = CollectorRegistry()
        ProcessCollector(registry=self._registry)
        self._registry.register(_MetricsCollector(platform, self))

    def note(self, method: str, route: str, status: int, lasted_s: float) -> None:
        known = method if method in METHODS else "other"
        self._counters.add(REQUESTS, (known, route, str(status)))
        self._counters.observe(REQUEST_SECONDS, (known, route), lasted_s)

    def note_bytes(self, came: int, went: int) -> None:
        """Count the bytes of the bodies of a request and its response."""
        self._counters.add(REQUEST_BYTES, ("in",), came)
        self._counters.add(REQUEST_BYTES, ("out",), went)

    def keep_writing(self) -> None:
        """Start a thread that writes this process's counters to the database every `TELL_S`."""
        self._is_heard = True
        Thread(target=self._keep_writing, name="counts", daemon=True).start()

    def tell(self) -> None:
        """Write the counters once. Raises `SQLAlchemyError` if the database is unreachable."""
        with self._write_lock:
            with self._platform.database.transaction() as session:
                committed = self._row.tell(session)
            committed()

    def exposition(self) -> bytes:
        return generate_latest(self._registry)

    def families(self) -> Iterator[Metric]:
        """Yield counts and status, with this process's own counts if it does not write them."""
        heartbeat_s = self._platform.settings.jobs.heartbeat_s
        own: Counts = {} if self._is_heard else self._row.counted()
        try:
            with self._platform.database.reading() as session:
                counts, now = summed((counters_of_all_processes(session), own)), platform_status(session, heartbeat_s)
        except SQLAlchemyError as error:
            log.warning("database unreachable", reason=str(error)[:200])
            yield GaugeMetricFamily("stone_database_up", "Whether the database responds", 0.0)
            return
        yield from counter_metrics(counts)
        yield from status_metrics(now)
        yield GaugeMetricFamily("stone_database_up", "Whether the database responds", 1.0)

    def _keep_writing(self) -> None:
        while True:
            time.sleep(TELL_S)
            try:
                self.tell()
            except SQLAlchemyError as error:
                log.warning("cannot write the counts; trying again", reason=str(error)[:200])


class _MetricsCollector(Collector):
    """Collects when Prometheus scrapes."""

    def __init__(self, platform: Platform, meters: RequestMetrics) -> None:
        self._platform, self._meters = platform, meters
        self._waiting = wake_up_counter(platform.settings)

    def describe(self) -> Iterator[Metric]:
        """Yield nothing, because registration must not read the database."""
        yield from ()

    def collect(self) -> Iterator[Metric]:
        yield from self._connections()  # before this scrape takes a connection itself
        for family in chain(self._meters.families(), self._wake_ups()):
            yield from under_both_names(family)
        yield from self._disks()

    def _connections(self) -> Iterator[Metric]:
        pool = self._platform.database.engine.pool
        if not isinstance(pool, QueuePool):
            return
        family = GaugeMetricFamily("stone_database_connections", "Database connections, by use", labels=("state",))
        family.add_metric(("in_use",), pool.checkedout())
        family.add_metric(("idle",), pool.checkedin())
        yield family
        yield GaugeMetricFamily("stone_database_pool_connections", "Database connections kept open", pool.size())

    def _disks(self) -> Iterator[Metric]:
        free = GaugeMetricFamily("stone_disk_free_bytes", "Free space on the disks used", labels=("place",))
        size = GaugeMetricFamily("stone_disk_bytes", "Size of the disks used", labels=("place",))
        for volume, folder in (("data", self._platform.settings.root), ("scratch", Path(gettempdir()))):
            room = disk(folder)
            if room.free_bytes is not None and room.total_bytes is not None:
                free.add_metric((volume,), room.free_bytes)
                size.add_metric((volume,), room.total_bytes)
        yield free
        yield size

    def _wake_ups(self) -> Iterator[Metric]:
        family = GaugeMetricFamily("stone_queue_wake_ups", "Wake-ups not yet received, by queue", labels=("queue",))
        is_up = True
        try:
            for queue in QUEUES:
                family.add_metric((queue,), self._waiting(queue))
        except (RedisError, OSError) as error:
            log.warning("broker unreachable", reason=str(error))
            is_up = False
        yield family
        yield GaugeMetricFamily("stone_broker_up", "Whether the broker responds", float(is_up))


# Counters and status figures as Prometheus metric families.
#
# **Conventions.** Names start with `stone_` and end in their unit. Counters of processes (`…_total`, histograms) and
# the platform's status are equal for every API process; if several are scraped, take the largest. `process_*`,
# `stone_database_connections` and `stone_disk_*` describe the scraped process alone.


def counter_metrics(counts: Counts) -> Iterator[Metric]:
    """Yield a family for every meter, including meters without counts."""
    for meter in METERS:
        of_meter = counts.get(meter.name, {})
        yield _histogram(meter, of_meter) if meter.bounds else _counter(meter, of_meter)


def status_metrics(now: PlatformStatus) -> Iterator[Metric]:
    """Yield families for jobs, queues, uploads, workers, chores, and the store."""
    jobs = GaugeMetricFamily("stone_jobs", f"Unfinished jobs; {MOST} means at least {MOST}", labels=("queue", "state"))
    for (queue, state), count in now.jobs.items():
        jobs.add_metric((queue, state), count)
    yield jobs
    yield _gauges("stone_queue_age_seconds", "Waiting time of the oldest ready job", "queue", now.oldest_ready_s)
    paused = {queue: float(queue in now.paused) for queue in now.oldest_ready_s}
    yield _gauges("stone_queue_paused", "Whether the queue starts no new jobs", "queue", paused)
    yield GaugeMetricFamily("stone_uploads_open", f"Unfinished uploads; {MOST} means at least {MOST}", now.uploads_open)
    yield _gauges("stone_chore_age_seconds", "Time since a chore of the sweeper last ran", "chore", now.chores_s)
    if STORED_BYTES in now.figures:
        yield GaugeMetricFamily("stone_stored_bytes", "Total size of all blobs", now.figures[STORED_BYTES])
        yield GaugeMetricFamily("stone_stored_blobs", "Blobs in the store", now.figures[STORED_BLOBS])
    yield GaugeMetricFamily("stone_store_faulty_objects", "Objects known to be damaged or lost", now.scrub.faults)
    yield GaugeMetricFamily("stone_scrub_pass_bytes", "Bytes read in the current scrub pass", now.scrub.size_bytes)
    if now.scrub.passed_ns is not None:
        passed_s = now.scrub.passed_ns / 1e9
        yield GaugeMetricFamily("stone_scrub_passed_timestamp_seconds", "End of the last full scrub pass", passed_s)
    yield from _workers(now.workers, now.oldest_ready_s)


def under_both_names(family: Metric) -> Iterator[Metric]:
    """Yield the family, and its copy under the previous name if it was renamed."""
    yield family
    for old, new in RENAMED.items():
        if family.name == new:
            alias = Metric(old, f"Deprecated: use {new}", family.type)
            for sample in family.samples:
                alias.add_sample(old + sample.name.removeprefix(new), sample.labels, sample.value, sample.timestamp)
            yield alias


def _workers(seen: Iterable[WorkerPresence], queues: Iterable[str]) -> Iterator[Metric]:
    alive = [presence.worker for presence in seen if not presence.is_silent]
    silent = [presence.worker for presence in seen if presence.is_silent]
    family = GaugeMetricFamily(
        "stone_workers", "Worker processes by the queues they listen to", labels=("queue", "state")
    )
    for queue in queues:
        for state, workers in (("alive", alive), ("silent", silent)):
            family.add_metric((queue, state), sum(queue in worker.queues.split(",") for worker in workers))
    yield family
    held = sum(worker.held_bytes or 0 for worker in alive)
    yield GaugeMetricFamily("stone_workers_held_bytes", "Total resident memory of all workers", held)
    for name, help_text, free in (
        (
            "stone_workers_disk_free_bytes",
            "Least free disk of any worker",
            [worker.disk_free_bytes for worker in alive],
        ),
        (
            "stone_workers_memory_free_bytes",
            "Least free memory of any worker",
            [presence.memory_free_bytes for presence in alive],
        ),
    ):
        known = [size_bytes for size_bytes in free if size_bytes is not None]
        if known:
            yield GaugeMetricFamily(name, help_text, min(known))


def _gauges(name: str, help_text: str, label: str, values: Mapping[str, float]) -> GaugeMetricFamily:
    family = GaugeMetricFamily(name, help_text, labels=(label,))
    for key, value in values.items():
        family.add_metric((key,), value)
    return family


def _counter(meter: MetricDefinition, counts: Mapping[str, Value]) -> CounterMetricFamily:
    family = CounterMetricFamily(meter.name, meter.description, labels=meter.labels)
    for key, value in counts.items():
        labels = key.split(BETWEEN)
        if len(labels) == len(meter.labels) and not isinstance(value, list):
            family.add_metric(labels, value)
    return family


def _histogram(meter: MetricDefinition, counts: Mapping[str, Value]) -> HistogramMetricFamily:
    family = HistogramMetricFamily(meter.name, meter.description, labels=meter.labels)
    ends = [*map(floatToGoString, meter.bounds), "+Inf"]
    for key, value in counts.items():
        labels = key.split(BETWEEN)
        if len(labels) == len(meter.labels) and isinstance(value, list) and len(value) == len(ends) + 1:
            family.add_metric(labels, list(zip(ends, accumulate(value[:-1]), strict=True)), value[-1])
    return family
