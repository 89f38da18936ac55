"""Probes tell the truth about what is away, quickly; counts and traces are for those who watch."""

import re
import shutil
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import httpx
import pytest
from opentelemetry.proto.trace.v1.trace_pb2 import Span
from prometheus_client.core import Metric
from prometheus_client.parser import text_string_to_metric_families
from pydantic import SecretStr
from redis import Redis

from api import probes
from api.metrics import RequestMetrics
from api.probes import Probes
from services.runtime.jobs.enqueue import enqueue
from services.runtime.jobs.specs import Context, JobSpec
from services.runtime.jobs.wakeup import wake_up_sender
from services.runtime.orm import new_id
from services.runtime.platform import Platform, open_platform
from services.runtime.settings import ApiSettings, BrokerSettings, DatabaseSettings
from services.runtime.store.protocol import Store
from services.runtime.telemetry.counter_rows import CounterWriter, fold
from services.runtime.telemetry.counters import RENAMED, WAKE_UPS_RESENT, ProcessCounters
from services.runtime.telemetry.tracing import close_tracing
from testing.api.serving import Person, client_of, person
from testing.servers.collector import Collector, collecting, facts_of
from testing.servers.fixtures import make_settings, opened
from testing.servers.process import free_port

WATCHING = "watching-watching-watching"


def with_broker(platform: Platform, redis_url: str) -> Platform:
    settings = platform.settings.model_copy(
        update={"broker": BrokerSettings(url=redis_url), "api": ApiSettings(metrics_token=SecretStr(WATCHING))}
    )
    return replace(platform, settings=settings)


def states(answer: httpx.Response) -> dict[str, str]:
    return {name: part["state"] for name, part in answer.json()["parts"].items()}


def test_with_everything_there_the_platform_is_ready(platform: Platform, redis_url: str) -> None:
    with client_of(with_broker(platform, redis_url)) as api:
        answer = api.get("/readyz")
        assert answer.status_code == 200, answer.text
        assert states(answer) == {"database": "up", "broker": "up", "store": "up"}
        assert all(part["took_ms"] > 0 for part in answer.json()["parts"].values())
        assert api.get("/healthz").json() == {"status": "ok"}


def test_without_its_broker_the_platform_is_not_ready_and_says_no_more(platform: Platform) -> None:
    away = with_broker(platform, "redis://:hunter2@127.0.0.1:1/0")
    with client_of(away) as api:
        answer = api.get("/readyz")
        assert (answer.status_code, states(answer)["broker"], states(answer)["database"]) == (503, "away", "up")
        assert "hunter2" not in answer.text
        assert api.get("/healthz").status_code == 200


def test_without_its_database_the_platform_is_not_ready(tmp_path: Path, redis_url: str) -> None:
    settings = make_settings(tmp_path, database=DatabaseSettings("postgresql://nobody@127.0.0.1:1/nothing"))
    with client_of(with_broker(opened(settings, []), redis_url)) as api:
        answer = api.get("/readyz")
        assert (answer.status_code, states(answer)["database"]) == (503, "away")


def test_without_its_data_folder_the_platform_is_not_ready(
    platform: Platform, redis_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(probes, "FRESH_S", 0.0)
    with client_of(with_broker(platform, redis_url)) as api:
        assert states(api.get("/readyz"))["store"] == "up"
        assert list(platform.store.listed("probes/")) == []
        shutil.rmtree(platform.settings.root / "store", ignore_errors=True)
        (platform.settings.root / "store").write_text("a file in the place of the folder")
        assert states(api.get("/readyz"))["store"] == "away"


def test_a_part_that_hangs_is_away_and_costs_one_thread(
    platform: Platform, redis_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(probes, "PATIENCE_S", 0.2)
    freed = threading.Event()

    class Hanging:
        def write(self, key: str, source: Path) -> None:
            freed.wait(300)
            self.kept = source.read_bytes()

        def read(self, key: str) -> list[bytes]:
            return [self.kept]

        def delete(self, key: str) -> None:
            self.kept = b""

    hanging: Store = Hanging()  # type: ignore[assignment]
    asking = Probes(replace(with_broker(platform, redis_url), store=hanging))
    before = threading.active_count()
    for _ in range(5):
        begun = time.monotonic()
        assert asking.ask()["store"].state == "away"
        assert time.monotonic() - begun < 5
    assert threading.active_count() - before <= 3
    freed.set()
    monkeypatch.setattr(probes, "PATIENCE_S", 5.0)
    deadline = time.monotonic() + 300
    while asking.ask()["store"].state != "up":
        assert time.monotonic() < deadline


def test_counts_are_not_public(platform: Platform, redis_url: str, curator: Person, administrator: Person) -> None:
    with client_of(with_broker(platform, redis_url)) as api:
        for header in (None, "Bearer ", "Bearer wrong", f"Bearer {WATCHING}x", "Bearer é"):
            headers = {} if header is None else {"Authorization": header.rstrip().encode("utf-8")}
            assert api.get("/metrics", headers=headers).status_code == 401, header
        assert api.get("/metrics", headers=curator.headers).status_code == 403
        for allowed in (administrator.headers, {"Authorization": f"Bearer {WATCHING}"}):
            assert api.get("/metrics", headers=allowed).status_code == 200


def test_a_monitoring_token_is_exchanged_while_the_old_one_still_works(platform: Platform, redis_url: str) -> None:
    watched = with_broker(platform, redis_url)
    both = watched.settings.model_copy(update={"api": ApiSettings(metrics_token=SecretStr(f"{WATCHING} next-token\n"))})
    with client_of(replace(watched, settings=both)) as api:
        for token, status in ((WATCHING, 200), ("next-token", 200), (f"{WATCHING} next-token", 401), ("next", 401)):
            assert api.get("/metrics", headers={"Authorization": f"Bearer {token}"}).status_code == status, token


def test_without_a_monitoring_token_an_empty_one_opens_nothing(api: httpx.Client) -> None:
    for header in ("Bearer", "Bearer  ", "Basic Og=="):
        assert api.get("/metrics", headers={"Authorization": header.strip()}).status_code == 401


def test_counts_name_routes_not_ids_and_what_the_queues_hold(platform_on: Platform, redis_url: str) -> None:
    caller = person(platform_on, "curator")
    with platform_on.database.transaction() as session:
        for _ in range(3):
            enqueue(session, JobSpec("ingest.register"), Context(caller.user_id))
    with client_of(with_broker(platform_on, redis_url)) as api:
        for token_id in ("0" * 32, "1" * 32):
            api.delete(f"/api/v1/tokens/{token_id}", headers=caller.headers)
        api.get("/api/v1/nothing/" + "2" * 32)
        api.request("PROPFIND", "/api/v1/coffee")
        exposed = api.get("/metrics", headers={"Authorization": f"Bearer {WATCHING}"}).text
    samples = {
        (sample.name, *sorted(sample.labels.values())): sample.value
        for family in text_string_to_metric_families(exposed)
        for sample in family.samples
    }
    assert samples["stone_requests_total", "/api/v1/tokens/{token_id}", "404", "DELETE"] == 2
    assert samples["stone_requests_total", "404", "GET", "unmatched"] == 1
    assert samples["stone_requests_total", "404", "other", "unmatched"] == 1
    assert samples["stone_jobs", "ingest", "ready"] == 3
    assert samples["stone_uploads_open",] == 0
    assert samples["stone_broker_up",] == 1
    assert samples["stone_queue_wake_ups", "ingest"] == 0
    assert not re.search("[0-9a-f]{32}", exposed)


def test_renamed_metrics_are_exposed_under_their_old_names_too(platform: Platform, redis_url: str) -> None:
    counted = ProcessCounters()
    counted.add(WAKE_UPS_RESENT, ("this test's",), 4.0)  # other tests of this process may have counted queues
    with platform.database.transaction() as session:
        CounterWriter(counted).tell(session)
    watched = with_broker(platform, redis_url)
    Redis.from_url(redis_url).delete("eval")
    wake_up_sender(watched.settings)("eval", 3)
    with client_of(watched) as api:
        exposed = api.get("/metrics", headers={"Authorization": f"Bearer {WATCHING}"}).text
    families = {family.name: family for family in text_string_to_metric_families(exposed)}
    for old, new in RENAMED.items():
        assert families[old].documentation == f"Deprecated: use {new}"
        assert families[old].type == families[new].type
        assert samples_of(families[old], old) == samples_of(families[new], new)
    assert samples_of(families["stone_queue_bells"], "stone_queue_bells")["", "eval"] == 3
    assert samples_of(families["stone_bells_rung_again"], "stone_bells_rung_again")["_total", "this test's"] == 4


def samples_of(family: Metric, name: str) -> dict[tuple[str, str], float]:
    """Values by the ending of the sample's name and its queue."""
    return {
        (sample.name.removeprefix(name), sample.labels["queue"]): sample.value
        for sample in family.samples
        if not sample.name.endswith("_created")
    }


def test_without_a_broker_the_other_counts_are_there(platform: Platform, administrator: Person) -> None:
    with client_of(with_broker(platform, "redis://127.0.0.1:1/0"), administrator) as api:
        exposed = api.get("/metrics").text
    assert "stone_broker_up 0.0" in exposed
    assert "stone_uploads_open 0.0" in exposed


def test_asking_often_costs_no_more(platform: Platform, redis_url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probes, "FRESH_S", 3600.0)
    monkeypatch.setattr(probes, "PATIENCE_S", 60.0)
    asking = Probes(with_broker(platform, redis_url))
    first = asking.ask()
    assert [asking.ask() for _ in range(20)] == [first] * 20


TEMPLATE = "/api/v1/sequences/{sequence_id}"


def counted(meters: RequestMetrics) -> dict[tuple[str, ...], float]:
    families = text_string_to_metric_families(meters.exposition().decode())
    return {
        (sample.name, *sorted(sample.labels.values())): sample.value for family in families for sample in family.samples
    }


def without_broker(platform: Platform) -> Platform:
    away = BrokerSettings(f"redis://127.0.0.1:{free_port()}/0")
    settings = platform.settings.model_copy(update={"broker": away})
    return Platform(settings, platform.database, platform.store)


def heard(platform: Platform) -> RequestMetrics:
    """As of a process of its own, told by the test instead of by a thread."""
    meters = RequestMetrics(without_broker(platform))
    meters._is_heard = True
    return meters


def test_each_process_answers_for_all_and_no_count_falls(platform_on: Platform) -> None:
    one, other = heard(platform_on), heard(platform_on)
    key = ("stone_requests_total", TEMPLATE, "200", "GET")
    seen = []
    for turn in range(4):
        one.note("GET", TEMPLATE, 200, 0.01)
        other.note("GET", TEMPLATE, 200, 0.01)
        one.tell()
        seen += [counted(meters).get(key, 0.0) for meters in (one, other)]
        if turn % 2:
            fold(platform_on, quiet_s=-1.0)
        other.tell()
    assert seen == [1.0, 1.0, 3.0, 3.0, 5.0, 5.0, 7.0, 7.0]
    assert counted(one)["stone_request_seconds_count", TEMPLATE, "GET"] == 8.0


def test_bytes_of_bodies_are_counted_by_where_they_go(platform: Platform) -> None:
    meters = RequestMetrics(without_broker(platform))
    meters.note_bytes(100, 7)
    meters.note_bytes(1, 0)
    found = counted(meters)
    assert (found["stone_request_bytes_total", "in"], found["stone_request_bytes_total", "out"]) == (101.0, 7.0)


def test_with_the_database_away_there_are_no_counts_but_a_word(platform: Platform) -> None:
    url = f"postgresql://stone@127.0.0.1:{free_port()}/stone"
    away = open_platform(without_broker(platform).settings.model_copy(update={"database": DatabaseSettings(url)}))
    meters = RequestMetrics(away)
    meters.note("GET", TEMPLATE, 200, 0.01)
    found = counted(meters)
    away.database.close()
    assert found["stone_database_up",] == 0.0
    assert found["stone_disk_free_bytes", "data"] > 0
    assert not [name for name, *_ in found if name.startswith(("stone_requests", "stone_jobs", "stone_queue_age"))]
    assert counted(RequestMetrics(without_broker(platform)))["stone_database_up",] == 1.0


TRACE, PARENT = "0123456789abcdef" * 2, "0123456789abcdef"
OFFERED = {"traceparent": f"00-{TRACE}-{PARENT}-01"}
ROUTE = "GET /api/v1/sequences/{sequence_id}"


@pytest.fixture
def collector(monkeypatch: pytest.MonkeyPatch) -> Iterator[Collector]:
    with collecting(monkeypatch) as running:
        yield running


def span_of_request(platform: Platform, caller: Person, collector: Collector, **headers: str) -> Span:
    """The span of one request, which is refused: the route takes no such parameter."""
    with client_of(platform, caller) as api:
        for path in ("/healthz", "/readyz", "/metrics"):
            api.get(path)
        answer = api.get(f"/api/v1/sequences/{new_id()}?name=hunter2", headers=headers)
        assert answer.status_code == 422
    close_tracing()  # now that the server has ended: a span ends after its answer
    assert len(collector.spans) == 1
    assert facts_of(collector.one(ROUTE))["stone.request.id"] == answer.headers["X-Request-ID"]
    return collector.one(ROUTE)


def test_a_span_has_the_routes_template_and_status_and_no_words(
    platform: Platform, curator: Person, collector: Collector
) -> None:
    facts = facts_of(span_of_request(platform, curator, collector))
    assert facts["http.route"] == "/api/v1/sequences/{sequence_id}"
    assert facts["http.response.status_code"] == 422
    assert b"hunter2" not in b"".join(collector.received)
    assert curator.name.encode() not in b"".join(collector.received)


def test_a_trace_from_outside_is_linked_and_not_continued(
    platform: Platform, curator: Person, collector: Collector
) -> None:
    span = span_of_request(platform, curator, collector, **OFFERED)
    assert span.trace_id.hex() != TRACE
    assert [(link.trace_id.hex(), link.span_id.hex()) for link in span.links] == [(TRACE, PARENT)]


def test_a_stranger_cannot_have_a_request_go_untraced(
    platform: Platform, curator: Person, collector: Collector
) -> None:
    span_of_request(platform, curator, collector, traceparent=f"00-{TRACE}-{PARENT}-00")


def test_behind_a_proxy_of_ours_its_trace_is_continued(
    platform: Platform, curator: Person, collector: Collector
) -> None:
    trusting = platform.settings.model_copy(update={"api": ApiSettings(trusts_traceparent=True)})
    span = span_of_request(replace(platform, settings=trusting), curator, collector, **OFFERED)
    assert (span.trace_id.hex(), span.parent_span_id.hex()) == (TRACE, PARENT)
    assert not span.links


def test_what_is_no_traceparent_is_not_minded(platform: Platform, curator: Person, collector: Collector) -> None:
    assert not span_of_request(platform, curator, collector, traceparent="00-" + "z" * 500).links
