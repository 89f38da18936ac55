"""Every set of values that the project offers, rendered once."""

from collections.abc import Sequence

import pytest

from tests.deploy.kubernetes.rendering import BACKUPS, Manifest, rendered

OFFERED = {
    "small": ("small",),
    "production": ("production",),
    "stopped": ("production", "stopped=true"),
    "scaled by wake-ups": ("small", "autoscaling.by=redis"),
    "backed up": ("small", "backup.enabled=true", BACKUPS),
    "restoring": ("small", "stopped=true", "backup.restore=true", BACKUPS),
}


@pytest.fixture(params=OFFERED)
def manifests(request: pytest.FixtureRequest) -> Sequence[Manifest]:
    return rendered(*OFFERED[request.param])
