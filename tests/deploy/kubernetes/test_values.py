"""Values that would do harm are refused before anything is sent to a cluster."""

import pytest

from tests.deploy.kubernetes.rendering import BACKUPS, template

ELSEWHERE = "bells of a Redis elsewhere"
REFUSED = {
    "a value that nothing reads": ("api.replica=3", "replica"),
    "an image without a fixed version": ("image.tag=latest", "tag"),
    "a secret among the settings": ("settings.database.password=x", "password"),
    "a way of scaling that is none": ("autoscaling.by=cpu", "by"),
    "a backup to nowhere": ("backup.enabled=true", "backup.volume"),
    "a backup that goes with its pod": ("backup.enabled=true,backup.volume.emptyDir.medium=Memory", "volume"),
    "a restore under a platform that works": (f"backup.restore=true,{BACKUPS}", "stopped"),
    "a size without a unit": ("api.scratch=100", "scratch"),
    "a database that everybody would be": ("network.database.to=null", "network.database"),
    "peers that nobody named": ("network.store.to=", "network"),
    ELSEWHERE: ("autoscaling.by=redis", "autoscaling.by"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_would_do_harm_is_refused(case: str) -> None:
    value, named = REFUSED[case]
    outcome = template("production" if case == ELSEWHERE else "small", value)
    assert outcome.returncode != 0
    assert named in outcome.stderr
