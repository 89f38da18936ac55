"""Pods are as a namespace of Pod Security "restricted" asks, and as the images promise to run."""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from importlib.util import find_spec
from typing import Any

import pytest

from services.runtime.settings import Settings
from tests.deploy.kubernetes.rendering import Manifest, containers, pods, rendered

OURS = {"api", "ingest", "labeler", "eval", "beat", "prepare", "backup"}
ONCE = {"prepare", "backup"}
DISKS = {"emptyDir", "secret", "configMap", "downwardAPI", "projected", "csi", "ephemeral", "persistentVolumeClaim"}
SECRETS: dict[str, set[str]] = {
    "api": {"stone_api__metrics_token", "stone_broker__password"},
    "prepare": {"stone_api__first_password"},
    "backup": set(),
    "redis": {"stone_broker__password"},
}
STORED = {"stone_database__password", "stone_store__s3_key_id", "stone_store__s3_secret"}


def environment(container: Manifest) -> dict[str, str]:
    return {one["name"]: one["value"] for one in container.get("env", ())}


def ours(manifests: Sequence[Manifest]) -> list[tuple[str, Manifest]]:
    return [(role, container) for role, container in containers(manifests) if role in OURS]


def bytes_of(amount: str) -> int:
    number, unit = re.fullmatch(r"(\d+)([KMGT]i)?", amount).groups()  # type: ignore[union-attr]
    return int(number) * 2 ** {None: 0, "Ki": 10, "Mi": 20, "Gi": 30, "Ti": 40}[unit]


def test_every_pod_is_restricted(manifests: Sequence[Manifest]) -> None:
    """https://kubernetes.io/docs/concepts/security/pod-security-standards, level `restricted`."""
    for role, pod in pods(manifests):
        spec, context = pod["spec"], pod["spec"]["securityContext"]
        assert context["runAsNonRoot"] is True, role
        assert context["runAsUser"] > 0, role
        assert context["seccompProfile"]["type"] == "RuntimeDefault", role
        assert not {"hostNetwork", "hostPID", "hostIPC"} & set(spec), role
        assert all(set(volume) - {"name"} <= DISKS for volume in spec["volumes"]), role
    for role, container in containers(manifests):
        context = container["securityContext"]
        assert context["allowPrivilegeEscalation"] is False, role
        assert context["capabilities"] == {"drop": ["ALL"]}, role
        assert "privileged" not in context, role
        assert all("hostPort" not in port for port in container.get("ports", ())), role


def test_no_pod_may_write_to_its_image_or_ask_the_cluster_anything(manifests: Sequence[Manifest]) -> None:
    for role, pod in pods(manifests):
        assert pod["spec"]["automountServiceAccountToken"] is False, role
        assert pod["spec"]["enableServiceLinks"] is False, role
    for role, container in containers(manifests):
        assert container["securityContext"]["readOnlyRootFilesystem"] is True, role


def test_nothing_is_kept_on_a_volume_that_a_pod_would_have_to_find_again(manifests: Sequence[Manifest]) -> None:
    for role, pod in pods(manifests):
        for volume in pod["spec"]["volumes"]:
            assert ("persistentVolumeClaim" in volume) == (volume["name"] == "backups"), role
            if "emptyDir" in volume:
                assert volume["emptyDir"]["sizeLimit"], role
    for role, container in ours(manifests):
        assert environment(container)["STONE_UPLOADS__BACKEND"] == "store", role


def test_every_container_says_what_it_asks_for_and_what_it_never_gets(manifests: Sequence[Manifest]) -> None:
    for role, container in containers(manifests):
        for side in ("requests", "limits"):
            assert set(container["resources"][side]) == {"cpu", "memory", "ephemeral-storage"}, (role, side)


def test_a_disk_of_a_pod_holds_twice_the_cache_and_is_within_its_limit(manifests: Sequence[Manifest]) -> None:
    """An object that is in use stays in the cache above its bound, and a run's mirror lies beside it."""
    for role, pod in pods(manifests):
        if role not in ("api", "ingest", "labeler", "eval"):
            continue
        disks = {
            one["name"]: bytes_of(one["emptyDir"]["sizeLimit"]) for one in pod["spec"]["volumes"] if "emptyDir" in one
        }
        [container] = pod["spec"]["containers"]
        assert 2 * int(environment(container)["STONE_STORE__CACHE_BYTES"]) <= disks["scratch"], role
        limit = bytes_of(container["resources"]["limits"]["ephemeral-storage"])
        assert disks["scratch"] + disks["temporary"] <= limit, role


def test_every_setting_is_one_that_the_platform_knows(manifests: Sequence[Manifest]) -> None:
    top = {
        name
        for name in Settings.model_fields
        if not hasattr(Settings.model_fields[name].default, "__dataclass_fields__")
    }
    for role, container in ours(manifests):
        for name in environment(container):
            if not name.startswith("STONE_"):
                assert name.startswith("OTEL_"), (role, name)
                continue
            group, _, one = name.removeprefix("STONE_").lower().partition("__")
            if not one:
                assert group in top, name
                continue
            known = {field.name for field in fields(Settings.model_fields[group].default)}
            assert one in known, name


def test_settings_arrive_as_they_were_written(monkeypatch: pytest.MonkeyPatch) -> None:
    """Helm reads numbers as floating point: what is large must not come out as 4.29e+10."""
    for name in [name for name in os.environ if name.startswith("STONE_")]:
        monkeypatch.delenv(name)
    [labeler] = [container for role, container in ours(rendered("production")) if role == "labeler"]
    for name, value in environment(labeler).items():
        monkeypatch.setenv(name, value)
    read = Settings()
    assert read.store.cache_bytes == 40 * 2**30
    assert (read.workers, read.jobs.drain_s) == (2, 120.0)
    assert read.database.url.endswith("sslmode=verify-full&sslrootcert=system")
    assert read.api.url == "https://stone.example.org"


def test_no_secret_is_in_an_environment_and_each_role_has_its_own_only(manifests: Sequence[Manifest]) -> None:
    for role, container in containers(manifests):
        assert all("valueFrom" not in one for one in container.get("env", ())), role
        assert not any("PASSWORD" in name or "SECRET" in name or "TOKEN" in name for name in environment(container)), (
            role
        )
    for role, pod in pods(manifests):
        given = {item["key"] for one in pod["spec"]["volumes"] for item in one.get("secret", {}).get("items", ())}
        own = SECRETS.get(role, {"stone_broker__password"})
        assert given == (own if role == "redis" else own | STORED), role


def test_commands_and_probes_are_modules_that_exist(manifests: Sequence[Manifest]) -> None:
    for role, container in ours(manifests):
        probes = [container[name] for name in ("startupProbe", "livenessProbe") if name in container]
        asked = [one["exec"]["command"] for one in probes if "exec" in one]
        for command in (container["command"], *asked):
            named = re.findall(r"python -m (\S+)", " ".join(command))
            assert named, role
            assert all(find_spec(module) is not None for module in named), named
        assert len(probes) == (0 if role in ONCE else 2), role


def stop_s(pod: Mapping[str, Any]) -> int:
    before = pod["spec"]["containers"][0].get("lifecycle", {}).get("preStop", {}).get("sleep", {}).get("seconds", 0)
    return int(pod["spec"]["terminationGracePeriodSeconds"]) - int(before)


def test_whoever_ends_has_the_time_to_drain(manifests: Sequence[Manifest]) -> None:
    needed = {"api": 30, "beat": 10, "ingest": 150, "labeler": 150, "eval": 150}
    for role, pod in pods(manifests):
        assert stop_s(pod) >= needed.get(role, 0), role
