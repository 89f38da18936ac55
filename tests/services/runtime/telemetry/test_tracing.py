"""Spans: switched on by the standard variables, one story across processes and hours, and never in the way of work."""

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress

import pytest

from services.runtime.jobs.claiming import claim
from services.runtime.jobs.running import run_next
from services.runtime.jobs.specs import Attempt, JobSpec, Outcome
from services.runtime.jobs.sweeping import Sweeper
from services.runtime.platform import Platform
from services.runtime.telemetry.tracing import (
    SpanSpec,
    close_tracing,
    current_ids,
    current_traceparent,
    is_asked_for,
    is_tracing,
    link,
    open_tracing,
    span,
)
from tests.servers.collector import Collector, collecting, facts_of
from tests.servers.process import free_port
from tests.services.runtime.jobs.steps import HANDLERS, a_job, a_run, an_owner, job

ON = {"OTEL_EXPORTER_OTLP_ENDPOINT": "http://127.0.0.1:4318"}


@pytest.fixture
def collector(monkeypatch: pytest.MonkeyPatch) -> Iterator[Collector]:
    with collecting(monkeypatch) as running:
        yield running


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({}, False),
        (ON, True),
        ({"OTEL_EXPORTER_OTLP_TRACES_ENDPOINT": "http://c/v1/traces"}, True),
        ({"OTEL_TRACES_EXPORTER": "otlp"}, True),
        ({**ON, "OTEL_TRACES_EXPORTER": "none"}, False),
        ({**ON, "OTEL_SDK_DISABLED": "true"}, False),
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": " "}, False),
    ],
)
def test_the_standard_variables_switch_it_on(variables: dict[str, str], expected: bool) -> None:
    assert is_asked_for(variables) is expected


def test_switched_off_nothing_is_loaded_and_nothing_is_told() -> None:
    program = """if True:
        import sys, api.main, services.runtime.celery_app
        from services.runtime.telemetry.tracing import *
        open_tracing("x")
        with span(SpanSpec("a")) as traced:
            traced.note({"a": 1}); traced.link("00-" + "1" * 32 + "-" + "1" * 16 + "-01"); traced.fault("x")
            assert current_traceparent() == "" and not current_ids() and not is_tracing()
        assert not [name for name in sys.modules if "otlp" in name or name == "opentelemetry.sdk.trace"]
    """
    kept = {name: value for name, value in os.environ.items() if not name.startswith("OTEL_")}
    subprocess.run([sys.executable, "-c", program], check=True, env=kept)


def test_a_run_is_one_trace_from_who_queued_it_through_every_attempt(
    platform_on: Platform, collector: Collector
) -> None:
    def planned(attempt: Attempt) -> Outcome:
        attempt.progress("look", 0, 2)
        attempt.progress("look", 1, 2)
        attempt.progress("write", 2, 2)
        return Outcome(then=(JobSpec("labeler.ok"),))

    owner = an_owner(platform_on)
    with span(SpanSpec("POST /process", "server")):
        a_run(platform_on, owner, JobSpec("ingest.plan"))
    assert run_next(platform_on, "ingest", {"ingest.plan": planned})
    assert run_next(platform_on, "labeler", HANDLERS)
    close_tracing()
    asked, first, then = (collector.one(name) for name in ("POST /process", "job ingest.plan", "job labeler.ok"))
    assert asked.trace_id == first.trace_id == then.trace_id
    assert (first.parent_span_id, then.parent_span_id) == (asked.span_id, first.span_id)
    stages = [collector.one(name) for name in ("look", "write")]
    assert {stage.parent_span_id for stage in stages} == {first.span_id}
    assert stages[0].end_time_unix_nano <= stages[1].start_time_unix_nano
    assert facts_of(then)["stone.job.outcome"] == "succeeded"


def test_each_attempt_has_its_span_with_the_code_of_its_failure(platform: Platform, collector: Collector) -> None:
    a_job(platform, an_owner(platform), "ingest.refuse")
    a_job(platform, an_owner(platform, "bob"), "ingest.stumble")
    while run_next(platform, "ingest", HANDLERS):
        pass
    close_tracing()
    refused, stumbled = collector.one("job ingest.refuse"), collector.named("job ingest.stumble")
    assert (facts_of(refused)["error.type"], facts_of(refused)["stone.job.outcome"]) == ("unreadable", "failed")
    assert [facts_of(one)["stone.job.attempt"] for one in stumbled] == [1, 2, 3]
    assert b"Input/output" not in b"".join(collector.said)
    assert b"byte 7" not in b"".join(collector.said)


def test_an_attempt_that_died_is_told_by_the_sweeper(platform: Platform, collector: Collector) -> None:
    with span(SpanSpec("asked")):
        a_job(platform, an_owner(platform))
    with platform.database.transaction() as session:
        assert claim(session, "ingest")
    clock = [0.0]
    sweeper = Sweeper(platform, lambda queue: 0, lambda queue, times: None, lambda: clock[0])
    sweeper.recover()
    clock[0] = platform.settings.jobs.lease_s
    assert sweeper.recover() == 1
    close_tracing()
    asked, lost = collector.one("asked"), collector.one("job ingest.ok")
    assert lost.trace_id == asked.trace_id
    assert facts_of(lost)["error.type"] == "lease_expired"


def test_links_go_to_spans_and_to_nothing_else(collector: Collector) -> None:
    with span(SpanSpec("before")):
        before = current_traceparent()
    with span(SpanSpec("after")):
        for traceparent in (before, "", "00-zz", "00-" + "0" * 32 + "-" + "1" * 16 + "-01", before + "-x"):
            link(traceparent)
    close_tracing()
    assert [link.span_id for link in collector.one("after").links] == [collector.one("before").span_id]


def test_what_raises_leaves_its_class_and_not_its_words(collector: Collector) -> None:
    with suppress(ValueError), span(SpanSpec("fails")):
        raise ValueError("hunter2")
    close_tracing()
    assert facts_of(collector.one("fails"))["error.type"] == "ValueError"
    assert b"hunter2" not in b"".join(collector.said)


def test_a_span_is_named_in_lines_only_within_it(collector: Collector) -> None:
    assert current_ids() == {}
    with span(SpanSpec("one")):
        ids = current_ids()
    close_tracing()
    one = collector.one("one")
    assert (ids["trace_id"], ids["span_id"]) == (one.trace_id.hex(), one.span_id.hex())
    assert collector.services() == {"stone-test"}


def test_a_child_of_a_fork_sends_nothing_and_starts_no_thread(collector: Collector) -> None:
    with span(SpanSpec("parent")):
        child = os.fork()
        if child == 0:
            with span(SpanSpec("child")):
                pass
            os._exit(sum(thread.name == "spans" for thread in threading.enumerate()))
        assert "spans" in [thread.name for thread in threading.enumerate()]
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    close_tracing()
    assert [one.name for _, one in collector.spans] == ["parent"]


def test_a_collector_that_is_away_holds_nobody_up(
    platform: Platform, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("services.runtime.telemetry.tracing.CLOSED_WITHIN_S", 0.2)
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", f"http://127.0.0.1:{free_port()}")
    open_tracing("stone-test")
    job_id = a_job(platform, an_owner(platform))
    assert run_next(platform, "ingest", HANDLERS)
    close_tracing()
    assert not is_tracing()
    assert job(platform, job_id).state == "succeeded"
