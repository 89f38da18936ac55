"""Which platforms ring: a broker that is away is told of by the one, and not even looked for by the other."""

from collections.abc import Callable
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from services.runtime.database import ring_after_commit
from services.runtime.platform import Platform, open_platform, open_silent_platform
from services.runtime.settings import BrokerSettings, Settings
from tests.servers.fixtures import make_settings

AWAY = BrokerSettings("redis://127.0.0.1:1/0")
NOT_HEARD = "bell not heard; the sweeper will ring again"


@pytest.mark.parametrize(("opening", "told"), [(open_platform, [NOT_HEARD]), (open_silent_platform, [])])
def test_only_a_platform_with_workers_rings(
    tmp_path: Path, opening: Callable[[Settings], Platform], told: list[str]
) -> None:
    platform = opening(make_settings(tmp_path, broker=AWAY))
    with capture_logs() as logs, platform.database.transaction() as session:
        ring_after_commit(session, "labeler")
    assert [line["event"] for line in logs] == told
    platform.database.close()
