"""Which platforms send wake-ups: a broker that is away is told of by the one, and not even looked for by the other."""

from collections.abc import Callable
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from services.runtime.database.transactions import wake_up_after_commit
from services.runtime.platform import Platform, open_platform, open_silent_platform
from services.runtime.settings import BrokerSettings, Settings
from testing.servers.fixtures import make_settings

AWAY = BrokerSettings("redis://127.0.0.1:1/0")
NOT_SENT = "wake-up not sent; the sweeper will send it again"


@pytest.mark.parametrize(("opening", "told"), [(open_platform, [NOT_SENT]), (open_silent_platform, [])])
def test_only_a_platform_with_workers_rings(
    tmp_path: Path, opening: Callable[[Settings], Platform], told: list[str]
) -> None:
    platform = opening(make_settings(tmp_path, broker=AWAY))
    with capture_logs() as logs, platform.database.transaction() as session:
        wake_up_after_commit(session, "labeler")
    assert [line["event"] for line in logs] == told
    platform.database.close()
