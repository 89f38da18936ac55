"""Users and teams of a simulated season, created over HTTP.

**Conventions.** Every user acts with their own token.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import httpx

from stone_client.api import Api
from stone_client.credentials import Server
from stone_client.errors import ServerRefusedError
from stone_client.files.tus import Purpose, hashed, upload_file

PASSWORD = "correct horse battery staple"
MODALITIES = ("C", "L", "C+L", "C+R", "C+L+R")


def silent(stage: str, done: int, total: int) -> None:
    """Default progress function; does nothing."""


@dataclass(frozen=True)
class SentSubmission:
    """A sent submission; `granted` is whether the team needed a grant for it."""

    id: str
    granted: bool


@dataclass(frozen=True)
class SeasonTeam:
    """A team of two, and the API of each member."""

    id: str
    name: str
    modality: str
    captain: Api
    member: Api


@dataclass(frozen=True)
class Season:
    """The platform under test with its administrator's API, and the season's phase."""

    admin: Api
    phase_id: str
    address: str

    def found_team(self, number: int) -> SeasonTeam:
        """Create a team of two; the second joins by invitation."""
        captain, member = (_person(self, f"{who}{number}") for who in ("captain", "member"))
        team = captain.create("/teams", {"name": f"Team {number:02d}"})
        secret = captain.send("POST", f"/teams/{team['id']}/invitations", json={}).json()["secret"]
        member.create("/teams/memberships", {"secret": secret})
        return SeasonTeam(team["id"], team["name"], MODALITIES[number % len(MODALITIES)], captain, member)

    def submit(self, by: tuple[SeasonTeam, Api], zipped: Path, method: str, kind: str = "entry") -> SentSubmission:
        """Create, upload and finalise a submission; a team without quota is refused first and then gets a grant."""
        team, api = by
        local = hashed(zipped, silent)
        fields = {"team_id": team.id, "method": method, "modality": team.modality, "kind": kind}
        file = {"sha256": local.sha256, "size_bytes": local.size_bytes}
        draft_id = api.create(f"/phases/{self.phase_id}/submissions", {**fields, **file})["id"]
        upload_id = upload_file(api, local, Purpose("submission", draft_id), silent)
        try:
            _finalise(api, draft_id, upload_id)
            return SentSubmission(draft_id, False)
        except ServerRefusedError as error:
            if error.code != "scorings_exhausted":
                raise
        grant = {"phase_id": self.phase_id, "scorings": 1, "reason": "the season is long"}
        self.admin.create(f"/admin/teams/{team.id}/grants", grant)
        _finalise(api, draft_id, upload_id)
        return SentSubmission(draft_id, True)

    def board(self, entries: str, **query: str) -> dict[str, object]:
        answer: dict[str, object] = self.admin.read(f"{self.address}/leaderboard", entries=entries, **query)
        return answer

    def states(self) -> dict[str, str]:
        """Return the state of every submission of the phase."""
        return {item["id"]: item["state"] for item in self.admin.pages("/submissions", phase_id=self.phase_id)}


def open_season(admin: Api, dataset: str, scorings: int) -> Season:
    """Create a benchmark with one hidden phase, `scorings` per team and week, and start its first ground truth."""
    phase = {"name": "test", "part": "test", "is_hidden": True, "scorings_per_window": scorings}
    body = {"name": "season", "dataset": dataset, "phases": [phase], "reason": "a season"}
    phase_id = admin.create("/admin/benchmarks", body)["phases"][0]["id"]
    admin.create(f"/admin/phases/{phase_id}/ground-truths", {"reason": "the first"})
    return Season(admin, phase_id, "/benchmarks/season/phases/test")


def close_all(season: Season, teams: Sequence[SeasonTeam]) -> None:
    for api in (season.admin, *(member_api for team in teams for member_api in (team.captain, team.member))):
        api.__exit__(None, None, None)


def _finalise(api: Api, draft_id: str, upload_id: str) -> None:
    api.create(f"/submissions/{draft_id}/finalize", {"upload_id": upload_id})


def signed_in(url: str, name: str, password: str) -> Api:
    """Return the API for this user, with a token issued after a browser's sign-in."""
    with httpx.Client(base_url=f"{url}/api/v1", trust_env=False, timeout=60.0) as browser:
        opened = browser.post("/sessions", json={"name": name, "password": password}).raise_for_status().json()
        csrf = {"X-CSRF-Token": opened["csrf_token"]}
        secret = browser.post("/tokens", json={"name": "laptop"}, headers=csrf).raise_for_status().json()["secret"]
    return Api(Server(url, secret))


def _person(season: Season, name: str) -> Api:
    body = {"name": name, "role": "participant", "password": PASSWORD, "reason": "takes part"}
    season.admin.create("/admin/users", body)
    return signed_in(season.admin.url, name, PASSWORD)
