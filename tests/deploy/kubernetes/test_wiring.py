"""What refers to something refers to something that is there."""

import re
from collections.abc import Sequence

from api.metrics import RequestMetrics
from services.runtime.jobs.broker_app import QUEUES
from services.runtime.platform import Platform
from tests.deploy.kubernetes.rendering import (
    Manifest,
    containers,
    of_kind,
    pods,
    rendered,
    role_of,
    roles_selected,
    selects,
)

QUERY = re.compile(r'^sum\(max by \(state\) \((\w+)\{queue="(\w+)",state=~"([\w|]+)"\}\)\)$')


def test_every_selector_chooses_the_pods_of_its_own_role_and_no_others(manifests: Sequence[Manifest]) -> None:
    for manifest in of_kind(manifests, "Deployment", "PodDisruptionBudget"):
        assert roles_selected(manifests, manifest["spec"]["selector"]) == {role_of(manifest)}
    for manifest in of_kind(manifests, "Service"):
        assert roles_selected(manifests, {"matchLabels": manifest["spec"]["selector"]}) == {role_of(manifest)}
    for role, pod in pods(manifests):
        for spread in pod["spec"].get("topologySpreadConstraints", ()):
            assert selects(spread["labelSelector"], pod["metadata"]["labels"]), role


def test_every_port_that_is_named_is_one_of_the_container_behind_it(manifests: Sequence[Manifest]) -> None:
    named = {(role, port["name"]) for role, container in containers(manifests) for port in container.get("ports", ())}
    for role, container in containers(manifests):
        for name in ("startupProbe", "livenessProbe", "readinessProbe"):
            for way in ("httpGet", "tcpSocket"):
                asked = container.get(name, {}).get(way)
                assert asked is None or (role, asked["port"]) in named
    for service in of_kind(manifests, "Service"):
        for port in service["spec"]["ports"]:
            assert (role_of(service), port["targetPort"]) in named
    [ingress] = of_kind(manifests, "Ingress")
    backend = ingress["spec"]["rules"][0]["http"]["paths"][0]["backend"]["service"]
    [service] = [one for one in of_kind(manifests, "Service") if one["metadata"]["name"] == backend["name"]]
    assert backend["port"]["name"] in {port["name"] for port in service["spec"]["ports"]}


def test_workers_scale_between_their_bounds_by_what_waits_for_them() -> None:
    for values in (("production",), ("small", "autoscaling.by=redis")):
        manifests = rendered(*values)
        deployments = {one["metadata"]["name"]: one for one in of_kind(manifests, "Deployment")}
        scaled = of_kind(manifests, "ScaledObject")
        assert {role_of(one) for one in scaled} == set(QUEUES)
        for one in scaled:
            target = deployments[one["spec"]["scaleTargetRef"]["name"]]
            assert role_of(target) == role_of(one)
            assert "replicas" not in target["spec"], "two would set it: whoever upgrades, and the autoscaler"
            assert one["spec"]["minReplicaCount"] <= one["spec"]["maxReplicaCount"]
            [trigger] = one["spec"]["triggers"]
            asked = trigger["metadata"]
            assert f'queue="{role_of(one)}"' in asked.get("query", "") or asked.get("listName") == role_of(one)


def test_what_is_asked_of_prometheus_is_told_by_the_api_also_when_there_is_nothing(platform: Platform) -> None:
    told = RequestMetrics(platform).exposition().decode()
    for one in of_kind(rendered("production"), "ScaledObject"):
        asked = one["spec"]["triggers"][0]["metadata"]
        [(name, queue, states)] = QUERY.findall(asked["query"])
        assert asked["ignoreNullValues"] == "false", "an outage is no lack of jobs"
        for state in states.split("|"):
            assert f'{name}{{queue="{queue}",state="{state}"}} 0.0' in told


def test_a_stopped_platform_runs_nothing_and_scales_nothing_up() -> None:
    manifests = rendered("production", "stopped=true")
    for deployment in of_kind(manifests, "Deployment"):
        assert deployment["spec"]["replicas"] == 0
    for scaled in of_kind(manifests, "ScaledObject"):
        assert scaled["metadata"]["annotations"]["autoscaling.keda.sh/paused-replicas"] == "0"
    assert not of_kind(manifests, "HorizontalPodAutoscaler")


def test_the_schema_is_brought_up_before_anything_of_a_release_changes(manifests: Sequence[Manifest]) -> None:
    [job] = of_kind(manifests, "Job")
    if job["metadata"]["name"] == "stone-restore":
        assert role_of(job) == "backup", "what is restored brings its own schema, onto nothing"
        return
    assert role_of(job) == "prepare"
    assert job["metadata"]["annotations"]["helm.sh/hook"] == "pre-install,pre-upgrade"
    images = {container["image"] for role, container in containers(manifests) if role in ("api", "prepare")}
    assert len(images) == 1, "the schema is that of the API's own code"
