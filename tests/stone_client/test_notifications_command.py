"""`stone notifications` against the real API: events are chosen and shown, unknown ones refused."""

import json

import pytest

from services.domain.notifications.choices import choices_of
from services.runtime.platform import Platform
from testing.api.serving import Person
from tests.stone_client.test_server_commands import _silence, as_owner, nobody, owner, stone, url

__all__ = ["_silence", "as_owner", "nobody", "owner", "url"]


@pytest.mark.usefixtures("as_owner")
def test_events_are_chosen_by_channel_and_taken_back(platform: Platform, owner: Person) -> None:
    assert stone("notifications", "on", "run.failed", "phase.opened", "--by", "email").exit_code == 0
    assert stone("notifications", "on", "quota.low", "--by", "webhook").exit_code == 0
    told = stone("notifications", "off", "phase.opened", "--by", "email")
    assert "e-mail to: e-mail is not configured on this platform; webhook: none yet" in told.stderr
    with platform.database.reading() as session:
        assert choices_of(session, owner.user_id) == {"email": ["run.failed"], "webhook": ["quota.low"]}
    listed = json.loads(stone("notifications", "list", "--json").stdout)
    assert (listed["email"], listed["webhook"]) == (["run.failed"], ["quota.low"])
    assert json.loads(stone("notifications", "deliveries", "--json").stdout) == {"deliveries": []}


@pytest.mark.usefixtures("as_owner")
def test_an_event_that_is_none_is_refused_with_those_there_are() -> None:
    refused = stone("notifications", "on", "run.won", "--by", "email")
    assert refused.exit_code != 0
    assert "'run.won': no such event; this server has run.done, run.failed" in refused.stderr
