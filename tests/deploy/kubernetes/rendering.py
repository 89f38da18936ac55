"""What Helm makes of the chart, as values.

**Conventions.** Helm is `.venv/bin/helm` (`deploy/install-helm.sh`) or the one on PATH; where there is neither, tests
are skipped with that reason. An object is the plain dictionary of its YAML; a role is its label
`app.kubernetes.io/component`.
"""

import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).resolve().parents[3]
KUBERNETES = ROOT / "deploy" / "kubernetes"
CHART = KUBERNETES / "stone"
RELEASE, NAMESPACE = "stone", "stone"
ROLE = "app.kubernetes.io/component"
HELM_FOR = "1.33.0"
BACKUPS = "backup.volume.persistentVolumeClaim.claimName=backups"

Manifest = Mapping[str, Any]


def helm() -> str:
    """The path of Helm; the test is skipped where there is none."""
    beside = Path(sys.executable).with_name("helm")
    found = str(beside) if beside.exists() else shutil.which("helm")
    if found is None:
        pytest.skip("helm is neither in .venv/bin nor on PATH: deploy/install-helm.sh puts it there")
    return found


def ran(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Helm with these arguments, which read nothing of this user's."""
    return subprocess.run(
        [helm(), *arguments], check=False, capture_output=True, text=True, env={"HOME": "/nonexistent"}
    )


def template(values: str, *sets: str) -> subprocess.CompletedProcess[str]:
    """`helm template` with `<values>.yaml`, and `--set` for each of `sets`."""
    chosen = ["--values", str(KUBERNETES / f"{values}.yaml"), *(word for one in sets for word in ("--set", one))]
    where = ["--namespace", NAMESPACE, "--kube-version", HELM_FOR]
    return ran("template", RELEASE, str(CHART), *where, *chosen)


@cache
def rendered(values: str, *sets: str) -> Sequence[Manifest]:
    """All objects of a release with these values."""
    outcome = template(values, *sets)
    assert outcome.returncode == 0, outcome.stderr
    return [found for found in YAML(typ="safe").load_all(outcome.stdout) if found]


def of_kind(manifests: Sequence[Manifest], *kinds: str) -> list[Manifest]:
    return [manifest for manifest in manifests if manifest["kind"] in kinds]


def role_of(manifest: Manifest) -> str:
    role: str = manifest["metadata"]["labels"][ROLE]
    return role


def pods(manifests: Sequence[Manifest]) -> Iterator[tuple[str, Manifest]]:
    """Role and pod template of everything that runs pods."""
    for manifest in of_kind(manifests, "Deployment", "Job"):
        yield role_of(manifest), manifest["spec"]["template"]
    for manifest in of_kind(manifests, "CronJob"):
        yield role_of(manifest), manifest["spec"]["jobTemplate"]["spec"]["template"]


def containers(manifests: Sequence[Manifest]) -> Iterator[tuple[str, Manifest]]:
    for role, pod in pods(manifests):
        spec = pod["spec"]
        for container in (*spec.get("initContainers", ()), *spec["containers"]):
            yield role, container


def selects(selector: Mapping[str, Any], labels: Mapping[str, str]) -> bool:
    """Whether a label selector (matchLabels, and matchExpressions with In) chooses these labels."""
    unknown = set(selector) - {"matchLabels", "matchExpressions"}
    assert not unknown, f"this test does not know {unknown}"
    for asked in selector.get("matchExpressions", ()):
        assert asked["operator"] == "In"
        if labels.get(asked["key"]) not in asked["values"]:
            return False
    return all(labels.get(key) == value for key, value in selector.get("matchLabels", {}).items())


def roles_selected(manifests: Sequence[Manifest], selector: Mapping[str, Any]) -> set[str]:
    """The roles whose pods a selector chooses."""
    return {role for role, pod in pods(manifests) if selects(selector, pod["metadata"]["labels"])}
