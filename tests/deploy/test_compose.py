"""docker-compose.yml says what the platform understands, hides what is secret and lets nothing run that need not."""

import os
import re
import shutil
import subprocess
import sys
from dataclasses import fields, is_dataclass
from ipaddress import ip_network
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML
from sqlalchemy import make_url

from services.runtime.database import roles as database_roles
from services.runtime.settings import ApiSettings, Settings
from tests.services.runtime.processes.test_trusted_proxies import client_seen

ROOT = Path(__file__).resolve().parents[2]
COMPOSE: dict[str, Any] = YAML(typ="safe").load((ROOT / "docker-compose.yml").read_text("utf-8"))
SERVICES: dict[str, dict[str, Any]] = COMPOSE["services"]
ROLES = ("api", "ingest", "labeler", "eval", "beat", "prepare")
OF_OTHERS = ("proxy", "redis", "postgres", "store")


def secrets_of(service: dict[str, Any]) -> dict[str, str]:
    """Return the file name inside the container of each secret of a service."""
    short = {one: one for one in service.get("secrets", []) if isinstance(one, str)}
    return short | {one["source"]: one["target"] for one in service.get("secrets", []) if not isinstance(one, str)}


def setting_names() -> set[str]:
    """Every variable that the settings read."""
    settings = Settings()
    names = {f"STONE_{name.upper()}" for name in Settings.model_fields}
    groups = {name: getattr(settings, name) for name in Settings.model_fields}
    return names | {
        f"STONE_{group.upper()}__{part.name.upper()}"
        for group, value in groups.items()
        if is_dataclass(value)
        for part in fields(value)
    }


@pytest.mark.skipif(shutil.which("podman") is None, reason="podman is not on PATH: apt-get install podman")
def test_the_compose_file_is_one_for_compose_too(tmp_path: Path) -> None:
    compose = Path(sys.executable).parent / "podman-compose"
    command: list[str | Path] = [compose, "--file", ROOT / "docker-compose.yml", "config"]
    outcome = subprocess.run(command, check=False, capture_output=True, text=True, cwd=tmp_path, timeout=300)
    assert outcome.returncode == 0, outcome.stderr
    assert "stone-labeler:" in outcome.stdout


@pytest.mark.parametrize("role", ROLES)
def test_what_a_role_is_told_is_a_setting(role: str) -> None:
    told = SERVICES[role]["environment"]
    assert {name for name in told if name.startswith("STONE_")} <= setting_names()
    assert "STONE_DATABASE__URL" in told


@pytest.mark.parametrize("name", SERVICES)
def test_nothing_may_do_more_than_it_needs(name: str) -> None:
    service = SERVICES[name]
    assert service["cap_drop"] == ["ALL"]
    assert service["read_only"] is True
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert not {"privileged", "network_mode", "pid", "ipc", "devices"} & set(service)
    assert {"cpus", "memory"} <= set(service["deploy"]["resources"]["limits"])
    if name in ROLES:
        assert "cap_add" not in service
        assert "user" not in service, "the image's own, which is nobody"


@pytest.mark.parametrize("name", SERVICES)
def test_an_image_is_one_version_and_starts_again_by_itself(name: str) -> None:
    service = SERVICES[name]
    assert re.search(r":(\$\{STONE_VERSION:-)?\d+\.\d+", service["image"])
    assert service["restart"] == ("no" if name == "prepare" else "unless-stopped")


def test_the_proxy_alone_is_reached_from_outside() -> None:
    assert [name for name, service in SERVICES.items() if "ports" in service] == ["proxy"]
    assert SERVICES["proxy"]["ports"] == ["${STONE_PORTS:-127.0.0.1:8080:8080}"]
    assert SERVICES["proxy"]["networks"] == ["edge"]
    assert COMPOSE["networks"]["inner"] == {"internal": True}
    assert [name for name, service in SERVICES.items() if "edge" in service["networks"]] == ["proxy", "api"]


def test_no_secret_is_in_the_file_or_in_an_environment() -> None:
    named = {source for service in SERVICES.values() for source in secrets_of(service)}
    assert named == set(COMPOSE["secrets"])
    for name, source in COMPOSE["secrets"].items():
        assert source == {"file": f"./deploy/compose/secrets/{name}"}
        assert name.upper() in setting_names()
    for service in SERVICES.values():
        words = {name for name in service.get("environment", {}) if re.search("PASSWORD|SECRET|TOKEN|KEY", name)}
        assert words <= {"POSTGRES_PASSWORD_FILE"}


@pytest.mark.parametrize("service", database_roles.ROLES)
def test_a_service_connects_by_its_own_role_alone(service: str) -> None:
    url = make_url(SERVICES[service]["environment"]["STONE_DATABASE__URL"])
    assert url.username == database_roles.name_of(service)
    of_database = {source: name for source, name in secrets_of(SERVICES[service]).items() if "database" in source}
    assert of_database == {f"stone_database__{service}_password": "stone_database__password"}
    assert ("stone_api__metrics_token" in secrets_of(SERVICES[service])) is (service == "api")


def test_the_owner_of_the_database_prepares_it_and_serves_nobody() -> None:
    holders = [name for name, service in SERVICES.items() if "stone_database__password" in secrets_of(service)]
    assert holders == ["prepare", "postgres"]
    assert make_url(SERVICES["prepare"]["environment"]["STONE_DATABASE__URL"]).username == "stone"
    given = {f"stone_database__{service}_password" for service in database_roles.ROLES}
    assert given <= set(secrets_of(SERVICES["prepare"]))


ENGINE = """#!/bin/sh
[ "$1" = pull ] && exit 0
[ "$3" = --format ] && [ "$5" != "${UNPUSHED:-}" ] && echo "${5%%:*}@sha256:$(echo "$5" | sha256sum | cut -c1-64)"
exit 0
"""


def test_the_images_of_others_are_pinned_by_digest(tmp_path: Path) -> None:
    """With a stand-in for the engine: no registry is reached here."""
    script = tmp_path / "deploy" / "compose" / "pin-images.sh"
    script.parent.mkdir(parents=True)
    shutil.copy(ROOT / "deploy" / "compose" / "pin-images.sh", script)
    shutil.copy(ROOT / "docker-compose.yml", tmp_path)
    engine = tmp_path / "engine"
    engine.write_text(ENGINE)
    engine.chmod(0o755)
    (tmp_path / ".env").write_text("STONE_SITE=here\nSTONE_REDIS_IMAGE=old\n")
    told = {"PATH": os.environ["PATH"], "ENGINE": str(engine)}
    for _ in range(2):
        subprocess.run([script], check=True, capture_output=True, env=told)
        kept = dict(line.split("=", 1) for line in (tmp_path / ".env").read_text().splitlines())
        assert kept.pop("STONE_SITE") == "here"
        assert set(kept) == {f"STONE_{name.upper()}_IMAGE" for name in OF_OTHERS}
        assert all(re.search("@sha256:[0-9a-f]{64}$", image) for image in kept.values())
    before = (tmp_path / ".env").read_text()
    refused = subprocess.run([script], check=False, capture_output=True, env={**told, "UNPUSHED": "redis:7.4"})
    assert refused.returncode == 1
    assert (tmp_path / ".env").read_text() == before


def test_a_stop_lasts_longer_than_a_drain() -> None:
    for worker in ("ingest", "labeler", "eval"):
        assert float(SERVICES[worker]["stop_grace_period"].rstrip("s")) > Settings().jobs.drain_s


def test_the_example_of_an_environment_names_what_the_file_reads_with_its_defaults() -> None:
    example = (ROOT / "deploy" / "compose" / "env.example").read_text("utf-8")
    shown = dict(re.findall(r"(?m)^(\w+)=(.*)$", example))
    file = (ROOT / "docker-compose.yml").read_text("utf-8")
    by_new_names = re.sub(r"\$\{(\w+):-\$\{\w+:-([^}]*)\}\}", r"${\1:-\2}", file)  # an old name stands in, if set
    read = dict(re.findall(r"\$\{(\w+):-([^}]*)\}", by_new_names))
    assert shown == read


def test_secrets_are_made_once_and_are_long(tmp_path: Path) -> None:
    script = tmp_path / "make-secrets.sh"
    script.write_bytes((ROOT / "deploy" / "compose" / "make-secrets.sh").read_bytes())
    script.chmod(0o755)
    made = [_secrets_after(script) for _ in range(2)]
    assert set(made[0]) == set(COMPOSE["secrets"])
    assert made[0] == made[1], "what is there stays"
    assert len(set(made[0].values())) == len(made[0])
    assert all(re.fullmatch("[0-9a-f]{48}", secret) for secret in made[0].values())
    assert (tmp_path / "secrets").stat().st_mode & 0o777 == 0o700


def _secrets_after(script: Path) -> dict[str, str]:
    subprocess.run([script], check=True, capture_output=True, env={"PATH": os.environ["PATH"]})
    return {path.name: path.read_text() for path in (script.parent / "secrets").iterdir()}


def test_who_asks_is_told_by_the_proxy_and_cannot_be_forged() -> None:
    """The proxy is the one in its network whose word is believed; with "*" a client's own header would be."""
    subnet = COMPOSE["networks"]["edge"]["ipam"]["config"][0]["subnet"]
    told = SERVICES["api"]["environment"]
    assert "FORWARDED_ALLOW_IPS" not in told
    assert subnet in told["STONE_API__TRUSTED_PROXIES"]
    own = re.search(r":-([0-9./]+)\}", subnet)
    assert own is not None
    peer = str(next(ip_network(own[1]).hosts()))
    settings = Settings(api=ApiSettings(trusted_proxies=own[1]))
    assert client_seen(settings, peer, ["6.6.6.6, 203.0.113.9"]) == "203.0.113.9"
    assert {name for name, service in SERVICES.items() if "edge" in service["networks"]} == {"proxy", "api"}
