"""What dashboard and alerts ask for is exposed, what they say is explained, and Prometheus itself agrees with both."""

import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families
from ruamel.yaml import YAML

from services.maintenance.sweeper import loops_of, recorded
from services.runtime.jobs.broker_app import QUEUES
from services.runtime.jobs.worker_presence import WorkerHeartbeat
from services.runtime.orm import Blob
from services.runtime.platform import Platform
from services.runtime.settings import BrokerSettings
from services.runtime.telemetry.counters import METERS, RENAMED
from testing.api.serving import client_of, person

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "deploy" / "observability"
PAGE = ROOT / "docs" / "operations" / "observability.md"
NAME = re.compile(r"\b(?:stone|process)[a-z0-9_:]*\b(?:\{([^}]*)\})?")
MATCHER = re.compile(r"(\w+)\s*(?:=~|!~|!=|=)")
OF_PROMETHEUS = {"le", "instance", "job"}
RULES: dict[str, Any] = YAML(typ="safe").load(FOLDER / "alerts.yml")
ALERTS = [rule for group in RULES["groups"] for rule in group["rules"] if "alert" in rule]
RECORDED = {rule["record"] for group in RULES["groups"] for rule in group["rules"] if "record" in rule}

Labels = dict[str, set[str]]


@pytest.fixture
def exposed(platform: Platform, redis_url: str) -> Labels:
    """The labels of every sample's name, of a platform in which everything has a value."""
    WorkerHeartbeat(platform, QUEUES).tell()
    with platform.database.transaction() as session:
        session.add(Blob(sha256="0" * 64, object_key="blobs/0", size_bytes=1))
    for chore in (chore for loop in recorded(platform, loops_of(platform)) for chore in loop.chores):
        chore.run_if_due(0.0)
    with_broker = replace(platform, settings=platform.settings.model_copy(update={"broker": BrokerSettings(redis_url)}))
    with client_of(with_broker, person(platform, "administrator")) as api:
        text = api.get("/metrics").text
    families = list(text_string_to_metric_families(text))
    labels: Labels = {}
    for sample in (sample for family in families for sample in family.samples):
        labels.setdefault(sample.name, set()).update(sample.labels)
    for meter in METERS:
        endings = ("_bucket", "_sum", "_count") if meter.bounds else ("_total",)
        labels |= {meter.name + ending: set(meter.labels) for ending in endings}
    assert {meter.name for meter in METERS} <= {family.name for family in families}
    return labels


def asked() -> Iterator[tuple[str, str, str]]:
    """Every name that a panel or a rule asks for: where, the name, its matchers."""
    panels = json.loads((FOLDER / "dashboard.json").read_text())["panels"]
    said = [(panel["title"], target["expr"]) for panel in panels for target in panel.get("targets", ())]
    said += [
        (rule.get("alert", rule.get("record")), rule["expr"]) for group in RULES["groups"] for rule in group["rules"]
    ]
    for where, expression in said:
        bare = re.sub(r'"[^"]*"', '""', expression)
        for found in NAME.finditer(bare):
            yield where, found[0].partition("{")[0], found[1] or ""


def test_every_metric_that_is_asked_for_is_exposed_with_the_labels_asked_by(exposed: Labels) -> None:
    names = list(asked())
    assert len(names) > 60
    for where, name, matchers in names:
        assert name in exposed or name in RECORDED, f"{where}: {name}"
        unknown = set(MATCHER.findall(matchers)) - exposed.get(name, set(MATCHER.findall(matchers))) - OF_PROMETHEUS
        assert not unknown, f"{where}: {name} has no label {unknown}"


def test_every_metric_of_ours_is_looked_at_and_explained(exposed: Labels) -> None:
    page = PAGE.read_text()
    looked_at = {name for _, name, _ in asked()}
    for name in exposed:
        if name.startswith("stone_"):
            base = re.sub(r"_(bucket|sum|count)$", "", name)
            assert f"`{base}`" in page, name
            is_old = base.removesuffix("_total") in RENAMED
            assert any(one.startswith(base) for one in looked_at) != is_old, name


def test_every_alert_is_explained_where_it_points_and_nothing_else_is() -> None:
    headings = re.findall(r"^### (\w+)$", PAGE.read_text(), re.MULTILINE)
    assert [rule["alert"] for rule in ALERTS] == headings
    for rule in ALERTS:
        assert rule["annotations"]["runbook"] == f"docs/operations/observability.md#{rule['alert'].lower()}"
        assert rule["labels"]["severity"] in {"critical", "warning", "info"}


def test_every_alert_is_fired_by_a_test_of_the_rules() -> None:
    tested = (FOLDER / "alerts_test.yml").read_text()
    assert [rule["alert"] for rule in ALERTS if rule["alert"] not in tested] == []


@pytest.mark.skipif(shutil.which("promtool") is None, reason="promtool is not on PATH: apt-get install prometheus")
@pytest.mark.parametrize(
    "command",
    [
        ("check", "rules", "alerts.yml"),
        ("test", "rules", "alerts_test.yml"),
        ("check", "config", "--syntax-only", "prometheus.yml"),
    ],
)
def test_prometheus_accepts_the_rules_and_they_fire_when_they_should(command: tuple[str, ...]) -> None:
    ended = subprocess.run(["promtool", *command], cwd=FOLDER, check=False, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stdout + ended.stderr
