"""Who may reach whom: exactly the arrows of the design, from both ends."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pytest

from tests.deploy.kubernetes.rendering import BACKUPS, Manifest, of_kind, pods, rendered, roles_selected, selects

Arrow = tuple[str, str, int]

WORKING = ("api", "ingest", "labeler", "eval", "beat")
OURS = (*WORKING, "prepare")


def outward(*roles: str) -> set[Arrow]:
    return {(role, place, port) for role in roles for place, port in (("dns", 53), ("database", 5432), ("store", 443))}


INWARD: set[Arrow] = {("ingress", "api", 8080), ("monitoring", "api", 8080)}
EVERYWHERE = INWARD | outward(*OURS)
OWN_REDIS: set[Arrow] = {(role, "redis", 6379) for role in WORKING}
TO_WEB, TO_MAIL = (f"network.{name}.to[0].ipBlock.cidr" for name in ("webhooks", "mail"))
DESIGNED: dict[str, tuple[tuple[str, ...], set[Arrow]]] = {
    "small": (("small",), EVERYWHERE | OWN_REDIS),
    "scaled by wake-ups": (("small", "autoscaling.by=redis"), EVERYWHERE | OWN_REDIS | {("keda", "redis", 6379)}),
    "backed up": (("small", "backup.enabled=true", BACKUPS), EVERYWHERE | OWN_REDIS | outward("backup")),
    "restoring": (
        ("small", "stopped=true", "backup.restore=true", BACKUPS),
        INWARD | outward(*WORKING, "backup") | OWN_REDIS,
    ),
    "telling": (
        ("small", f"{TO_WEB}=0.0.0.0/0", f"{TO_MAIL}=192.0.2.25/32"),
        EVERYWHERE | OWN_REDIS | {("beat", "web", 443), ("beat", "mail", 587)},
    ),
    "production": (
        ("production",),
        EVERYWHERE | {(role, "broker", 6379) for role in WORKING} | {(role, "traces", 4318) for role in WORKING},
    ),
}
PLACES = {
    "0.0.0.0/0": "web",
    "192.0.2.25/32": "mail",
    "192.0.2.10/32": "database",
    "198.51.100.0/28": "database",
    "192.0.2.11/32": "store",
    "203.0.113.0/24": "store",
    "198.51.100.16/28": "broker",
}


def place_of(peer: Mapping[str, Any], port: int) -> str:
    """What somebody outside the release is called here."""
    if "ipBlock" in peer:
        return PLACES[peer["ipBlock"]["cidr"]]
    namespace = peer["namespaceSelector"]["matchLabels"]["kubernetes.io/metadata.name"]
    if namespace == "kube-system":
        return "dns" if port == 53 else "ingress"
    return "traces" if port == 4318 else str(namespace)


def ends(manifests: Sequence[Manifest], peer: Mapping[str, Any], port: int) -> set[str]:
    """The roles or the place that a peer stands for."""
    is_ours = set(peer) == {"podSelector"}
    return roles_selected(manifests, peer["podSelector"]) if is_ours else {place_of(peer, port)}


def allowed(manifests: Sequence[Manifest], way: str) -> Iterator[Arrow]:
    """Arrows that the policies allow on the side of who sends (`egress`) or of who receives (`ingress`)."""
    other = {"egress": "to", "ingress": "from"}[way]
    for policy in of_kind(manifests, "NetworkPolicy"):
        mine = roles_selected(manifests, policy["spec"]["podSelector"])
        for rule in policy["spec"].get(way, ()):
            assert rule[other], "an empty list of peers means everybody"
            for port in {one["port"] for one in rule["ports"]}:
                for peer in rule[other]:
                    for end in ends(manifests, peer, port):
                        yield from ((role, end, port) if way == "egress" else (end, role, port) for role in mine)


@pytest.mark.parametrize("shape", DESIGNED)
def test_exactly_the_designed_arrows_are_open(shape: str) -> None:
    values, designed = DESIGNED[shape]
    manifests = rendered(*values)
    roles = {role for role, _ in pods(manifests)}
    leaving, entering = set(allowed(manifests, "egress")), set(allowed(manifests, "ingress"))
    within = {arrow for arrow in designed if arrow[0] in roles and arrow[1] in roles}
    assert {arrow for arrow in leaving if arrow[1] in roles} == within
    assert {arrow for arrow in entering if arrow[0] in roles} == within
    assert leaving | entering == designed


def test_every_pod_is_closed_in_both_directions_unless_something_opens_it(manifests: Sequence[Manifest]) -> None:
    for role, pod in pods(manifests):
        closing = [
            policy
            for policy in of_kind(manifests, "NetworkPolicy")
            if selects(policy["spec"]["podSelector"], pod["metadata"]["labels"])
            and set(policy["spec"]["policyTypes"]) == {"Ingress", "Egress"}
            and not policy["spec"].get("ingress")
            and not policy["spec"].get("egress")
        ]
        assert closing, role
