"""A phase with entries, and the people who look at its board over HTTP.

**Conventions.** Entries are laid down by `boards.py`: true records and draws of counts that a test makes up. `member`
is of the team whose entry is `mine`; `other` of the team whose entry is `theirs`.
"""

from dataclasses import dataclass
from typing import Any

import httpx

from services.runtime.orm import Benchmark, Team, TeamMember
from services.runtime.platform import Platform
from testing.api.serving import Person, person
from tests.services.domain.benchmarks.boards import Made, Scene, scene

URL = "/api/v1"


@dataclass(frozen=True)
class Boarding:
    """Who looks, at what, by which client."""

    at: Scene
    api: httpx.Client
    administrator: Person
    member: Person
    other: Person
    mine: str
    theirs: str
    team: str
    benchmark: str

    @property
    def path(self) -> str:
        return f"{URL}/benchmarks/{self.benchmark}/phases/val"

    def read(self, path: str, caller: Person | None = None, **query: Any) -> httpx.Response:
        headers = (caller or self.other).headers
        return self.api.get(path, params=query, headers=headers)

    def board(self, caller: Person | None = None, **query: Any) -> dict[str, Any]:
        return answered(self.read(f"{self.path}/leaderboard", caller, **query))

    def of(self, submission_id: str, part: str, caller: Person | None = None, **query: Any) -> httpx.Response:
        """What is answered of a submission: results, provenance, …"""
        return self.read(f"{URL}/submissions/{submission_id}/{part}", caller, **query)


def answered(reply: httpx.Response) -> dict[str, Any]:
    assert reply.status_code == 200, reply.text
    body: dict[str, Any] = reply.json()
    return body


def refused(reply: httpx.Response) -> tuple[int, str]:
    return reply.status_code, reply.json()["code"]


def boarding(api: httpx.Client, platform: Platform) -> Boarding:
    """An open phase with one entry of each of two teams; `mine` is the better one."""
    at = scene(platform)
    member, other = person(platform, "participant"), person(platform, "participant")
    teams = [at.team(), at.team()]
    with platform.database.transaction() as session:
        for team_id, one in zip(teams, (member, other), strict=True):
            session.add(TeamMember(team_id=team_id, user_id=one.user_id))
        name = session.get_one(Team, teams[0]).name
        benchmark = session.get_one(Benchmark, at.place.phase.benchmark_id).name
    mine = at.enter(teams[0], Made(0.2), description="How it is done")
    theirs = at.enter(teams[1], Made(0.4))
    return Boarding(at, api, person(platform, "administrator"), member, other, mine, theirs, name, benchmark)
