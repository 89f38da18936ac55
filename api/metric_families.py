"""Counters and status figures as Prometheus metric families.

**Conventions.** Names begin with `stone_` and end in their unit. What processes counted (`…_total`, histograms) and the
platform's status are the same whichever API process is asked: of several, take the largest. Of the process asked
alone are `process_*`, `stone_database_connections` and `stone_disk_*`.
"""

from collections.abc import Iterable, Iterator, Mapping
from itertools import accumulate

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.utils import floatToGoString

from services.runtime.jobs.worker_presence import WorkerPresence
from services.runtime.telemetry.counters import BETWEEN, METERS, RENAMED, Counts, MetricDefinition, Value
from services.runtime.telemetry.platform_status import MOST, PlatformStatus
from services.runtime.telemetry.sweeper_statistics import STORED_BLOBS, STORED_BYTES


def counter_metrics(counts: Counts) -> Iterator[Metric]:
    """A family for every meter, also for those that counted nothing yet."""
    for meter in METERS:
        of_meter = counts.get(meter.name, {})
        yield _histogram(meter, of_meter) if meter.bounds else _counter(meter, of_meter)


def status_metrics(now: PlatformStatus) -> Iterator[Metric]:
    """Jobs, queues, uploads, workers, chores, and what the store holds."""
    jobs = GaugeMetricFamily("stone_jobs", f"Jobs that have not ended; {MOST}: at least", labels=("queue", "state"))
    for (queue, state), count in now.jobs.items():
        jobs.add_metric((queue, state), count)
    yield jobs
    yield _gauges("stone_queue_age_seconds", "How long the oldest ready job is ready", "queue", now.oldest_ready_s)
    paused = {queue: float(queue in now.paused) for queue in now.oldest_ready_s}
    yield _gauges("stone_queue_paused", "Whether nothing new of a queue is started", "queue", paused)
    yield GaugeMetricFamily("stone_uploads_open", f"Uploads under way; {MOST}: at least", now.uploads_open)
    yield _gauges("stone_chore_age_seconds", "Since when a chore of the sweeper was not done", "chore", now.chores_s)
    if STORED_BYTES in now.figures:
        yield GaugeMetricFamily("stone_stored_bytes", "Bytes of all blobs", now.figures[STORED_BYTES])
        yield GaugeMetricFamily("stone_stored_blobs", "Blobs in the store", now.figures[STORED_BLOBS])
    yield from _workers(now.workers, now.oldest_ready_s)


def under_both_names(family: Metric) -> Iterator[Metric]:
    """The family, and what the release before called it, if it had another name then."""
    yield family
    for old, new in RENAMED.items():
        if family.name == new:
            alias = Metric(old, f"Deprecated: use {new}", family.type)
            for sample in family.samples:
                alias.add_sample(old + sample.name.removeprefix(new), sample.labels, sample.value, sample.timestamp)
            yield alias


def _workers(seen: Iterable[WorkerPresence], queues: Iterable[str]) -> Iterator[Metric]:
    alive = [one.worker for one in seen if not one.is_silent]
    silent = [one.worker for one in seen if one.is_silent]
    family = GaugeMetricFamily(
        "stone_workers", "Worker processes by the queues they listen to", labels=("queue", "state")
    )
    for queue in queues:
        for state, workers in (("alive", alive), ("silent", silent)):
            family.add_metric((queue, state), sum(queue in worker.queues.split(",") for worker in workers))
    yield family
    held = sum(worker.held_bytes or 0 for worker in alive)
    yield GaugeMetricFamily("stone_workers_held_bytes", "Memory that workers hold (resident), together", held)
    for name, told, free in (
        ("stone_workers_disk_free_bytes", "Least free disk of any worker", [one.disk_free_bytes for one in alive]),
        ("stone_workers_memory_free_bytes", "Least free memory of any", [one.memory_free_bytes for one in alive]),
    ):
        known = [size_bytes for size_bytes in free if size_bytes is not None]
        if known:
            yield GaugeMetricFamily(name, told, min(known))


def _gauges(name: str, told: str, label: str, values: Mapping[str, float]) -> GaugeMetricFamily:
    family = GaugeMetricFamily(name, told, labels=(label,))
    for key, value in values.items():
        family.add_metric((key,), value)
    return family


def _counter(meter: MetricDefinition, counts: Mapping[str, Value]) -> CounterMetricFamily:
    family = CounterMetricFamily(meter.name, meter.told, labels=meter.labels)
    for key, value in counts.items():
        labels = key.split(BETWEEN)
        if len(labels) == len(meter.labels) and not isinstance(value, list):
            family.add_metric(labels, value)
    return family


def _histogram(meter: MetricDefinition, counts: Mapping[str, Value]) -> HistogramMetricFamily:
    family = HistogramMetricFamily(meter.name, meter.told, labels=meter.labels)
    ends = [*map(floatToGoString, meter.bounds), "+Inf"]
    for key, value in counts.items():
        labels = key.split(BETWEEN)
        if len(labels) == len(meter.labels) and isinstance(value, list) and len(value) == len(ends) + 1:
            family.add_metric(labels, list(zip(ends, accumulate(value[:-1]), strict=True)), value[-1])
    return family
