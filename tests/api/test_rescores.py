"""A re-score over HTTP: started, followed, read as a difference, activated; and alarms and grants."""

from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import select

from services.domain.benchmarks.alarms.alarms import raise_alarms
from services.runtime.orm import AuditEntry, Score
from services.runtime.platform import Platform
from stone.scoring.metric import METRIC_VERSION
from testing.api.serving import Person
from testing.worlds.benchmark_world import World, benchmark_world, new_truth, predicted, run_eval, submission_zip
from testing.worlds.made import NOBODY
from tests.api.submitting import URL, Submitting, answered, refused, submitting
from tests.services.domain.benchmarks.scored import Place, another_truth, phase_of_rows, scored, scored_entry, team


class Administrating:
    """An administrator at the re-scores of a phase."""

    def __init__(self, api: httpx.Client, caller: Person, phase_id: str) -> None:
        self.api, self.caller, self.phase_id = api, caller, phase_id

    def ask(self, method: str, path: str, body: Any = None, **headers: str) -> httpx.Response:
        address = f"{URL}/admin/phases/{self.phase_id}/rescores{path}"
        return self.api.request(method, address, json=body, headers={**self.caller.headers, **headers})

    def start(self, **asked: str) -> dict[str, Any]:
        return answered(self.ask("POST", "", {"reason": "labels corrected", **asked}), 202)

    def activate(self, rescore_id: str, tag: str) -> httpx.Response:
        return self.ask("POST", f"/{rescore_id}/activate", {"reason": "as announced"}, **{"If-Match": tag})

    def acts(self, platform: Platform) -> list[str]:
        with platform.database.reading() as session:
            entries = select(AuditEntry.act).where(AuditEntry.subject_id == self.phase_id).order_by(AuditEntry.number)
            return list(session.scalars(entries))


@pytest.fixture
def place(platform: Platform) -> Place:
    return phase_of_rows(platform)


@pytest.fixture
def admin(api: httpx.Client, administrator: Person, place: Place) -> Administrating:
    return Administrating(api, administrator, place.phase.id)


@pytest.mark.whole
def test_the_whole_way_from_new_labels_to_a_switched_board(
    api: httpx.Client, platform: Platform, tmp_path: Path
) -> None:
    world = benchmark_world(platform, frames=2)
    first, second = (_submit(api, world, tmp_path, number) for number in range(2))
    admin = Administrating(api, world.administrator, world.val)
    truth_id = new_truth(platform, world.val, world.administrator.user_id)
    started = admin.start(truth_id=truth_id)
    assert (started["state"], started["total"], started["missing"]) == ("running", 2, 2)
    while_pending = _submit(api, world, tmp_path, 2)
    shown = answered(admin.ask("GET", f"/{started['id']}"), 200)
    assert (shown["state"], shown["scored"], shown["missing"]) == ("complete", 3, 0)
    assert _pairs(platform, while_pending) == {(_active_truth(api, world), METRIC_VERSION), (truth_id, METRIC_VERSION)}
    diff = admin.ask("GET", f"/{started['id']}/diff")
    rows = answered(diff, 200)["rows"]
    assert {row["submission_id"] for row in rows} == {first, second, while_pending}
    assert all(row["old"] == row["new"] and row["rank_move"] == 0 for row in rows)
    answered(admin.activate(started["id"], diff.headers["ETag"]), 200)
    assert _active_truth(api, world) == truth_id
    assert answered(admin.ask("GET", f"/{started['id']}"), 200)["state"] == "activated"
    assert admin.acts(platform) == ["phase.rescore", "phase.activate"]


def test_the_difference_names_moves_in_rank_and_value(place: Place, admin: Administrating) -> None:
    teams = [team(place, name) for name in ("Alpha", "Beta", "Gamma")]
    ids = [scored_entry(place, one, value) for one, value in zip(teams, (0.5, 0.4, 0.3), strict=True)]
    baseline = scored_entry(place, teams[0], 0.9, kind="baseline")
    truth_id = another_truth(place)
    started = admin.start(truth_id=truth_id)
    for submission_id, value in zip((*ids, baseline), (0.45, 0.48, 0.2, 0.8), strict=True):
        scored(place, submission_id, value, truth_id)
    diff = answered(admin.ask("GET", f"/{started['id']}/diff"), 200)
    moves = [(row["team"], row["old_rank"], row["new_rank"], row["rank_move"]) for row in diff["rows"]]
    assert moves == [("Beta", 2, 1, 1), ("Alpha", 1, 2, -1), ("Gamma", 3, 3, 0), ("Alpha", None, None, None)]
    assert [round(row["value_move"], 6) for row in diff["rows"]] == [0.08, -0.05, -0.1, -0.1]
    assert (diff["is_order_changed"], diff["is_new_leader"], diff["largest_rank_move"]) == (True, True, 1)
    assert diff["largest_value_move"] == pytest.approx(0.1)
    assert (diff["old"]["truth_number"], diff["new"]["truth_number"]) == (1, 2)


def test_an_activated_re_score_still_shows_what_it_changed(place: Place, admin: Administrating) -> None:
    one = scored_entry(place, team(place), 0.5)
    truth_id = another_truth(place)
    started = admin.start(truth_id=truth_id)
    scored(place, one, 0.4, truth_id)
    before = answered(admin.ask("GET", f"/{started['id']}/diff"), 200)
    answered(admin.activate(started["id"], "*"), 200)
    after = answered(admin.ask("GET", f"/{started['id']}/diff"), 200)
    assert (after["old"], after["new"], after["rows"]) == (before["old"], before["new"], before["rows"])


def test_the_page_escapes_what_strangers_wrote(place: Place, admin: Administrating) -> None:
    scored_entry(place, team(place, "<b>|team|"), 0.5, method="[click](http://evil) `x`")
    started = admin.start(truth_id=another_truth(place))
    page = admin.ask("GET", f"/{started['id']}/diff?format=md")
    assert page.headers["content-type"] == "text/markdown; charset=utf-8"
    assert page.headers["ETag"].startswith('"')
    row = page.text.splitlines()[-1]
    assert "\\<b\\>\\|team\\|" in row
    assert "\\[click\\]\\(http\\:\\/\\/evil\\) \\`x\\`" in row
    assert row.replace("\\|", "").count("|") == 11
    assert "0 of 1 submissions on the board have a score by the new evaluation version; still missing: 1." in page.text


def test_a_switch_names_the_board_it_means(place: Place, admin: Administrating) -> None:
    first, second = (admin.start(truth_id=another_truth(place)) for _ in range(2))
    tag = admin.ask("GET", f"/{first['id']}/diff").headers["ETag"]
    without = admin.ask("POST", f"/{first['id']}/activate", {"reason": "as announced"})
    assert refused(without) == (428, "precondition_required")
    answered(admin.activate(first["id"], tag), 200)
    assert refused(admin.activate(second["id"], tag)) == (412, "precondition_failed")
    assert refused(admin.activate(first["id"], "*")) == (409, "wrong_state")


def test_a_re_score_of_another_phase_is_none_of_this_one(place: Place, admin: Administrating) -> None:
    other = phase_of_rows(place.platform)
    started = Administrating(admin.api, admin.caller, other.phase.id).start(truth_id=another_truth(other))
    for method, path in (("GET", ""), ("GET", "/diff"), ("POST", "/activate"), ("POST", "/abandon")):
        reply = admin.ask(method, f"/{started['id']}{path}", {"reason": "mine"} if method == "POST" else None)
        assert refused(reply) == (404, "not_found")


def test_an_abandoned_re_score_is_over(place: Place, admin: Administrating) -> None:
    scored_entry(place, team(place))
    started = admin.start(truth_id=another_truth(place))
    ended = answered(admin.ask("POST", f"/{started['id']}/abandon", {"reason": "a mistake"}), 200)
    assert (ended["state"], ended["missing"]) == ("abandoned", 1)
    assert refused(admin.ask("POST", f"/{started['id']}/abandon", {"reason": "again"})) == (409, "wrong_state")
    assert refused(admin.activate(started["id"], "*")) == (409, "wrong_state")
    assert [one["id"] for one in answered(admin.ask("GET", ""), 200)["items"]] == [started["id"]]
    assert admin.acts(place.platform) == ["phase.rescore", "phase.abandon"]


def test_alarms_are_listed_until_they_are_dismissed(place: Place, admin: Administrating) -> None:
    for name in ("Alpha", "Beta"):
        submission_id = scored_entry(place, team(place, name))
        with place.platform.database.transaction() as session:
            row = session.scalars(select(Score).where(Score.submission_id == submission_id)).one()
            raise_alarms(session, row)
    address, headers = f"{URL}/admin/phases/{place.phase.id}/alarms", admin.caller.headers
    (alarm,) = answered(admin.api.get(address, headers=headers), 200)["items"]
    assert (alarm["kind"], alarm["facts"]["team"]) == ("equal_content", "Beta")
    dismissing = f"{URL}/admin/alarms/{alarm['id']}/dismiss"
    for reply, expected in (
        (admin.api.post(dismissing, json={"reason": " "}, headers=headers), (422, "invalid_request")),
        (admin.api.post(dismissing.replace(alarm["id"], NOBODY), json={"reason": "x"}, headers=headers), None),
    ):
        assert refused(reply) == (expected or (404, "alarm_missing"))
    assert answered(admin.api.post(dismissing, json={"reason": "one lab"}, headers=headers), 200)["dismissed_at"]
    assert refused(admin.api.post(dismissing, json={"reason": "again"}, headers=headers)) == (409, "wrong_state")
    assert answered(admin.api.get(address, headers=headers), 200)["items"] == []
    assert len(answered(admin.api.get(f"{address}?dismissed=true", headers=headers), 200)["items"]) == 1


def test_a_grant_lets_a_team_have_more_scored(api: httpx.Client, platform: Platform, administrator: Person) -> None:
    participant = submitting(api, platform, scorings_per_window=1)
    participant.submitted()
    draft = participant.announced()
    upload_id = participant.upload(draft)
    assert refused(participant.finalize(draft["id"], upload_id)) == (429, "scorings_exhausted")
    body = {"phase_id": participant.phase_id, "scorings": 1, "reason": "the platform was away"}
    address = f"{URL}/admin/teams/{participant.team_id}/grants"
    granted = answered(api.post(address, json=body, headers=administrator.headers), 201)
    assert (granted["scorings"], granted["limit"], granted["reserved"]) == (1, 2, 1)
    answered(participant.finalize(draft["id"], upload_id), 202)
    for path, changed in ((address.replace(participant.team_id, NOBODY), body), (address, body | {"phase_id": NOBODY})):
        assert refused(api.post(path, json=changed, headers=administrator.headers)) == (404, "not_found")


def _submit(api: httpx.Client, world: World, folder: Path, number: int) -> str:
    """The id of a submission to the open phase that was scored, by one of the two teams in turn."""
    team_of = Submitting(api, world.captains[number % 2], world.val, world.teams[number % 2])
    path = submission_zip(folder / f"{number}.zip", predicted(world.truth("val"), 0.1 * (number + 1), number))
    submission_id: str = team_of.submitted(path.read_bytes())["id"]
    run_eval(world.platform)
    assert team_of.shown(submission_id)["state"] == "scored"
    return submission_id


def _pairs(platform: Platform, submission_id: str) -> set[tuple[str, str]]:
    with platform.database.reading() as session:
        scores = select(Score.truth_id, Score.metric).where(Score.submission_id == submission_id)
        return {(truth_id, metric) for truth_id, metric in session.execute(scores)}


def _active_truth(api: httpx.Client, world: World) -> str:
    address = f"{URL}/admin/phases/{world.val}/ground-truths"
    items = answered(api.get(address, headers=world.administrator.headers), 200)["items"]
    return next(str(one["id"]) for one in items if one["is_active"])
