"""What all processes counted each of them answers alike; it never falls, nor is it guessed with the database away."""

from prometheus_client.parser import text_string_to_metric_families

from api.metrics import RequestMetrics
from services.runtime.platform import Platform, open_platform
from services.runtime.settings import BrokerSettings, DatabaseSettings
from services.runtime.telemetry.counter_rows import fold
from testing.servers.process import free_port

ROUTE = "/api/v1/sequences/{sequence_id}"


def samples(meters: RequestMetrics) -> dict[tuple[str, ...], float]:
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
    key = ("stone_requests_total", ROUTE, "200", "GET")
    seen = []
    for turn in range(4):
        one.note("GET", ROUTE, 200, 0.01)
        other.note("GET", ROUTE, 200, 0.01)
        one.tell()
        seen += [samples(meters).get(key, 0.0) for meters in (one, other)]
        if turn % 2:
            fold(platform_on, quiet_s=-1.0)
        other.tell()
    assert seen == [1.0, 1.0, 3.0, 3.0, 5.0, 5.0, 7.0, 7.0]
    assert samples(one)["stone_request_seconds_count", ROUTE, "GET"] == 8.0


def test_bytes_of_bodies_are_counted_by_where_they_go(platform: Platform) -> None:
    meters = RequestMetrics(without_broker(platform))
    meters.note_bytes(100, 7)
    meters.note_bytes(1, 0)
    found = samples(meters)
    assert (found["stone_request_bytes_total", "in"], found["stone_request_bytes_total", "out"]) == (101.0, 7.0)


def test_with_the_database_away_there_are_no_counts_but_a_word(platform: Platform) -> None:
    url = f"postgresql://stone@127.0.0.1:{free_port()}/stone"
    away = open_platform(without_broker(platform).settings.model_copy(update={"database": DatabaseSettings(url)}))
    meters = RequestMetrics(away)
    meters.note("GET", ROUTE, 200, 0.01)
    found = samples(meters)
    away.database.close()
    assert found["stone_database_up",] == 0.0
    assert found["stone_disk_free_bytes", "data"] > 0
    assert not [name for name, *_ in found if name.startswith(("stone_requests", "stone_jobs", "stone_queue_age"))]
    assert samples(RequestMetrics(without_broker(platform)))["stone_database_up",] == 1.0
