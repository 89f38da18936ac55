"""Spans: one story across processes and hours, sent if it is asked for and never in the way of work; and log lines."""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress

import pytest
from opentelemetry import trace
from opentelemetry.trace import SpanKind

from services.runtime.jobs.claims import claim
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.lease_sweep import Sweeper
from services.runtime.jobs.specs import Attempt, JobSpec, Outcome
from services.runtime.platform import Platform
from services.runtime.sandbox.parent import sandboxed
from services.runtime.telemetry.log_lines import name_span
from services.runtime.telemetry.origins import context_of, link_to, origin_trace
from services.runtime.telemetry.tracing import close_tracing, is_asked_for, setup_tracing, span, tracer
from testing.servers.collector import Collector, collecting, facts_of
from testing.servers.process import free_port
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


def test_libraries_that_trace_by_themselves_find_no_tracer_of_ours(collector: Collector) -> None:
    with trace.get_tracer("fastapi").start_as_current_span("GET /secret?name=hunter2"):
        pass
    close_tracing()
    assert collector.spans == []


def test_links_go_to_spans_and_to_nothing_else(collector: Collector) -> None:
    with span("before"):
        before = origin_trace()
    with span("after"):
        for traceparent in (before, "", "00-zz", "00-" + "0" * 32 + "-" + "1" * 16 + "-01", before + "-x"):
            link_to(traceparent)
    close_tracing()
    assert [link.span_id for link in collector.one("after").links] == [collector.one("before").span_id]


def test_a_run_is_one_trace_from_who_queued_it_through_every_attempt(platform: Platform, collector: Collector) -> None:
    def planned(attempt: Attempt) -> Outcome:
        attempt.progress("look", 0, 2)
        attempt.progress("look", 1, 2)
        attempt.progress("write", 2, 2)
        return Outcome(then=(JobSpec("labeler.ok"),))

    owner = an_owner(platform)
    with span("POST /process", SpanKind.SERVER):
        a_run(platform, owner, JobSpec("ingest.plan"))
    assert run_next(platform, "ingest", {"ingest.plan": planned})
    assert run_next(platform, "labeler", HANDLERS)
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
    assert b"Input/output" not in b"".join(collector.received)
    assert b"byte 7" not in b"".join(collector.received)


def test_an_attempt_that_died_is_told_by_the_sweeper(platform: Platform, collector: Collector) -> None:
    with span("asked"):
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


def test_what_raises_leaves_its_class_and_not_its_words(collector: Collector) -> None:
    with suppress(ValueError), span("fails"):
        raise ValueError("hunter2")
    close_tracing()
    assert facts_of(collector.one("fails"))["error.type"] == "ValueError"
    assert b"hunter2" not in b"".join(collector.received)


def test_a_span_is_named_in_lines_only_within_it_and_has_the_parent_that_it_is_given(collector: Collector) -> None:
    assert name_span(None, "info", {}) == {}
    with span("asked", within=context_of("00-" + "1" * 32 + "-" + "2" * 16 + "-01")), span("inner", within=None):
        ids = name_span(None, "info", {})
        assert context_of("") is None
        assert context_of("00-" + "1" * 32 + "-" + "0" * 16 + "-01") is None
    close_tracing()
    asked, inner = collector.one("asked"), collector.one("inner")
    assert (asked.trace_id.hex(), asked.parent_span_id.hex()) == ("1" * 32, "2" * 16)
    assert inner.parent_span_id == asked.span_id
    assert (ids["trace_id"], ids["span_id"]) == (inner.trace_id.hex(), inner.span_id.hex())
    assert collector.services() == {"stone-test"}


def test_a_child_of_a_fork_sends_nothing_and_has_one_thread(collector: Collector) -> None:
    with span("parent"):
        child = os.fork()
        if child == 0:
            with span("child"):
                pass
            os._exit(threading.active_count() - 1)
        assert any("Span" in thread.name for thread in threading.enumerate())
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        assert sandboxed(lambda: b"%d" % len(os.listdir("/proc/self/task"))) == b"1"
    with span("after"):
        pass
    close_tracing()
    assert sorted(one.name for _, one in collector.spans) == ["after", "parent"]


def test_a_collector_that_is_away_holds_nobody_up(
    platform: Platform, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("services.runtime.telemetry.tracing.CLOSED_WITHIN_S", 0.2)
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", f"http://127.0.0.1:{free_port()}")
    setup_tracing("stone-test")
    job_id = a_job(platform, an_owner(platform))
    assert run_next(platform, "ingest", HANDLERS)
    close_tracing()
    assert not tracer().start_span("late").is_recording()
    assert job(platform, job_id).state == "succeeded"


PROGRAM = """
import logging, structlog
from services.runtime.telemetry.log_lines import speak_json
speak_json()
speak_json()
log = structlog.get_logger("ours")
with structlog.contextvars.bound_contextvars(request_id="r-7"):
    log.info("said", count=3, odd=object())
    logging.getLogger("uvicorn.error").warning("theirs %s", 1)
    logging.getLogger("uvicorn.access").info("GET /?cursor=whole")
log.debug("too quiet")
def fail(password):
    return 1 / 0
try:
    fail("hunter2")
except ZeroDivisionError as error:
    log.error("fault", exc_info=error)
"""


def test_ours_and_the_libraries_lines_are_json_with_the_request() -> None:
    ended = subprocess.run([sys.executable, "-c", PROGRAM], check=True, capture_output=True, text=True)
    assert ended.stdout == ""
    said, theirs, fault = [json.loads(line) for line in ended.stderr.splitlines()]
    assert (said["event"], said["count"], said["request_id"], said["level"]) == ("said", 3, "r-7", "info")
    assert said["timestamp"].endswith("Z")
    assert (theirs["event"], theirs["logger"], theirs["request_id"]) == ("theirs 1", "uvicorn.error", "r-7")
    assert fault["exception"][0]["exc_type"] == "ZeroDivisionError"
    assert "request_id" not in fault
    assert "hunter2" not in ended.stderr
    assert "cursor" not in ended.stderr
