"""A request's span names its route and never its words; whose trace it is in, strangers do not decide."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
from opentelemetry.proto.trace.v1.trace_pb2 import Span

from services.runtime.orm import new_id
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings
from services.runtime.telemetry.tracing import close_tracing
from testing.api.serving import Person, client_of
from testing.servers.collector import Collector, collecting, facts_of

TRACE, PARENT = "0123456789abcdef" * 2, "0123456789abcdef"
OFFERED = {"traceparent": f"00-{TRACE}-{PARENT}-01"}
ROUTE = "GET /api/v1/sequences/{sequence_id}"


@pytest.fixture
def collector(monkeypatch: pytest.MonkeyPatch) -> Iterator[Collector]:
    with collecting(monkeypatch) as running:
        yield running


def asked(platform: Platform, caller: Person, collector: Collector, **headers: str) -> Span:
    """The span of one request, which finds nothing."""
    with client_of(platform, caller) as api:
        for path in ("/healthz", "/readyz", "/metrics"):
            api.get(path)
        answer = api.get(f"/api/v1/sequences/{new_id()}?name=hunter2", headers=headers)
        assert answer.status_code == 404
    close_tracing()  # now that the server has ended: a span ends after its answer
    assert len(collector.spans) == 1
    assert facts_of(collector.one(ROUTE))["stone.request.id"] == answer.headers["X-Request-ID"]
    return collector.one(ROUTE)


def test_a_span_has_the_routes_template_and_status_and_no_words(
    platform: Platform, curator: Person, collector: Collector
) -> None:
    facts = facts_of(asked(platform, curator, collector))
    assert facts["http.route"] == "/api/v1/sequences/{sequence_id}"
    assert facts["http.response.status_code"] == 404
    assert b"hunter2" not in b"".join(collector.said)
    assert curator.name.encode() not in b"".join(collector.said)


def test_a_trace_from_outside_is_linked_and_not_continued(
    platform: Platform, curator: Person, collector: Collector
) -> None:
    span = asked(platform, curator, collector, **OFFERED)
    assert span.trace_id.hex() != TRACE
    assert [(link.trace_id.hex(), link.span_id.hex()) for link in span.links] == [(TRACE, PARENT)]


def test_a_stranger_cannot_have_a_request_go_untraced(
    platform: Platform, curator: Person, collector: Collector
) -> None:
    asked(platform, curator, collector, traceparent=f"00-{TRACE}-{PARENT}-00")


def test_behind_a_proxy_of_ours_its_trace_is_continued(
    platform: Platform, curator: Person, collector: Collector
) -> None:
    trusting = platform.settings.model_copy(update={"api": ApiSettings(trusts_traceparent=True)})
    span = asked(replace(platform, settings=trusting), curator, collector, **OFFERED)
    assert (span.trace_id.hex(), span.parent_span_id.hex()) == (TRACE, PARENT)
    assert not span.links


def test_what_is_no_traceparent_is_not_minded(platform: Platform, curator: Person, collector: Collector) -> None:
    assert not asked(platform, curator, collector, traceparent="00-" + "z" * 500).links
