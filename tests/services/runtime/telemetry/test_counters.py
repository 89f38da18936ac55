"""Counts add up like numbers, whoever counted them."""

import json
from threading import Thread

from hypothesis import given
from hypothesis import strategies as st

from services.runtime.telemetry.counters import Counts, ProcessCounters, less, summed
from services.runtime.telemetry.metric_names import FRAMES, JOB_SECONDS, METERS

counts = st.dictionaries(
    st.sampled_from(["stone_frames", "stone_store_bytes"]),
    st.dictionaries(st.sampled_from(["in", "out"]), st.integers(0, 2**40).map(float)),
)


def test_what_threads_count_at_once_is_all_counted() -> None:
    tallies = ProcessCounters()

    def count() -> None:
        for _ in range(2000):
            tallies.add(FRAMES, ("scored",))

    counting = [Thread(target=count) for _ in range(4)]
    for thread in counting:
        thread.start()
    for thread in counting:
        thread.join()
    assert tallies.counts() == {"stone_frames": {"scored": 8000.0}}


def test_a_histogram_puts_each_value_into_the_first_bucket_that_holds_it() -> None:
    tallies = ProcessCounters()
    for value in (0.0, 0.05, 0.06, 1800.0, 1801.0):
        tallies.observe(JOB_SECONDS, ("ingest.register", "succeeded"), value)
    (row,) = tallies.counts()["stone_job_seconds"].values()
    assert isinstance(row, list)
    *buckets, total = row
    assert (buckets[0], buckets[1], buckets[-2], buckets[-1]) == (2.0, 1.0, 1.0, 1.0)
    assert sum(buckets) == 5.0
    assert total == 0.05 + 0.06 + 1800.0 + 1801.0


def test_a_copy_does_not_grow() -> None:
    tallies = ProcessCounters()
    tallies.observe(JOB_SECONDS, ("k", "o"), 1.0)
    before = json.dumps(tallies.counts())
    taken = tallies.counts()
    tallies.observe(JOB_SECONDS, ("k", "o"), 1.0)
    assert json.dumps(taken) == before


@given(counts, counts, counts)
def test_sums_do_not_depend_on_who_is_added_first(one: Counts, two: Counts, three: Counts) -> None:
    assert summed((summed((one, two)), three)) == summed((one, summed((two, three))))
    assert summed((one, two)) == summed((two, one))


@given(counts, counts)
def test_what_was_counted_in_between_is_the_difference(before: Counts, more: Counts) -> None:
    between = less(summed((before, more)), before)
    assert {(name, key): value for name, of in between.items() for key, value in of.items() if value} == {
        (name, key): value for name, of in more.items() for key, value in of.items() if value
    }


def test_histograms_of_two_versions_are_not_mixed() -> None:
    assert summed(({"h": {"k": [1.0, 2.0, 3.0]}}, {"h": {"k": [1.0, 1.0]}})) == {"h": {"k": [1.0, 2.0, 3.0]}}
    assert summed(({"c": {"k": 1.0}}, {"c": {"k": [1.0]}})) == {"c": {"k": 1.0}}


def test_labels_of_no_meter_can_hold_what_lies_between_labels() -> None:
    assert all("|" not in label for meter in METERS for label in meter.labels)
    assert len({meter.name for meter in METERS}) == len(METERS)
    assert all(list(meter.bounds) == sorted(set(meter.bounds)) for meter in METERS)
