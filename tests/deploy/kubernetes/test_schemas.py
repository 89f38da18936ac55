"""Every object is what Kubernetes, KEDA and the Prometheus operator say such an object is.

Catches alone a field that Kubernetes does not know, of all that the chart may write.
"""

import json
from collections.abc import Sequence
from functools import cache
from typing import Any

import jsonschema
import kubernetes_validate
import pytest

from tests.deploy.kubernetes.rendering import CHART, Manifest, ran

pytestmark = pytest.mark.whole

OLDEST, NEWEST = "1.33", "1.37"
TEXT, COUNT = {"type": "string"}, {"type": "integer", "minimum": 0}


def closed(required: Sequence[str] = (), **properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "additionalProperties": False, "required": list(required)}


# What of `keda.sh/v1alpha1` the chart uses (kedacore/keda, config/crd/bases/keda.sh_scaledobjects.yaml).
SCALED_OBJECT = closed(
    ("scaleTargetRef", "triggers"),
    scaleTargetRef=closed(("name",), apiVersion=TEXT, kind=TEXT, name=TEXT),
    minReplicaCount=COUNT,
    maxReplicaCount=COUNT,
    pollingInterval=COUNT,
    cooldownPeriod=COUNT,
    fallback=closed(("failureThreshold", "replicas"), failureThreshold=COUNT, replicas=COUNT),
    advanced=closed(horizontalPodAutoscalerConfig=closed(behavior={"type": "object"})),
    triggers={
        "type": "array",
        "minItems": 1,
        "items": closed(
            ("type", "metadata"),
            type={"enum": ["prometheus", "redis"]},
            metricType={"enum": ["AverageValue", "Value", "Utilization"]},
            metadata={"type": "object", "additionalProperties": TEXT},
            authenticationRef=closed(("name",), name=TEXT),
        ),
    },
)
AUTHENTICATION = closed(
    ("secretTargetRef",),
    secretTargetRef={
        "type": "array",
        "items": closed(("parameter", "name", "key"), parameter=TEXT, name=TEXT, key=TEXT),
    },
)
MONITOR = closed(("selector", "endpoints"), selector=closed(("matchLabels",), matchLabels={"type": "object"}),
                 endpoints={"type": "array", "minItems": 1})  # fmt: skip
OF_OTHERS = {
    ("keda.sh/v1alpha1", "ScaledObject"): SCALED_OBJECT,
    ("keda.sh/v1alpha1", "TriggerAuthentication"): AUTHENTICATION,
    ("monitoring.coreos.com/v1", "ServiceMonitor"): MONITOR,
}


@cache
def validate(spelled: str, version: str) -> None:
    """Once for each object, however many releases have it: the validator reads all schemas each time."""
    kubernetes_validate.validate(json.loads(spelled), version, strict=True)


@pytest.mark.parametrize("version", [OLDEST, NEWEST])
def test_every_plain_object_is_valid_to_the_letter(manifests: Sequence[Manifest], version: str) -> None:
    plain = [one for one in manifests if (one["apiVersion"], one["kind"]) not in OF_OTHERS]
    assert len(plain) >= 20
    for spelled in {json.dumps(manifest) for manifest in plain}:
        validate(spelled, version)


def test_every_object_of_an_operator_is_as_that_operator_asks(manifests: Sequence[Manifest]) -> None:
    for manifest in manifests:
        schema = OF_OTHERS.get((manifest["apiVersion"], manifest["kind"]))
        if schema:
            jsonschema.validate(manifest["spec"], schema)


def test_helm_finds_nothing_to_say_of_the_chart() -> None:
    outcome = ran("lint", "--strict", str(CHART), "--values", str(CHART.parent / "small.yaml"))
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
