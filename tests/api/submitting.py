"""A team submits over HTTP: announce, upload by tus, finalise."""

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

import httpx

from services.runtime.platform import Platform
from testing.api.serving import Person
from testing.api.tus import create, patch
from tests.services.domain.benchmarks.drafts import ZIP, Entrant, entrant_on

URL = "/api/v1"


@dataclass(frozen=True)
class Submitting:
    """Somebody who submits to a phase for a team."""

    api: httpx.Client
    caller: Person
    phase_id: str
    team_id: str

    def announce(self, content: bytes = ZIP, where: str = "submissions", **said: Any) -> httpx.Response:
        file = {"sha256": sha256(content).hexdigest(), "size_bytes": len(content)}
        body = {"team_id": self.team_id, "method": "Net", "modality": "L", **file, **said}
        headers = {**self.caller.headers, **said.pop("headers", {})}
        body.pop("headers", None)
        return self.api.post(f"{URL}/phases/{self.phase_id}/{where}", json=body, headers=headers)

    def announced(self, content: bytes = ZIP, where: str = "submissions", **said: Any) -> dict[str, Any]:
        return answered(self.announce(content, where, **said), 201)

    def upload(self, draft: Mapping[str, Any], content: bytes = ZIP) -> str:
        """The id of the complete upload."""
        said = {"filename": "run.zip", "purpose": "submission", "target_id": draft["id"], "sha256": draft["sha256"]}
        reply = create(self.api, self.caller, len(content), **said)
        assert reply.status_code == 201, reply.text
        where = reply.headers["Location"]
        if reply.headers["Upload-Offset"] == "0":
            sent = patch(self.api, self.caller, where, 0, content)
            assert sent.status_code == 204, sent.text
        return str(where.rpartition("/")[2])

    def finalize(self, submission_id: str, upload_id: str) -> httpx.Response:
        return self.post(f"{submission_id}/finalize", {"upload_id": upload_id})

    def submitted(self, content: bytes = ZIP, where: str = "submissions", **said: Any) -> dict[str, Any]:
        """A submission that is queued."""
        draft = self.announced(content, where, **said)
        return answered(self.finalize(draft["id"], self.upload(draft, content)), 202)

    def post(self, path: str, body: Any = None) -> httpx.Response:
        return self.api.post(f"{URL}/submissions/{path}", json=body, headers=self.caller.headers)

    def read(self, path: str) -> httpx.Response:
        return self.api.get(f"{URL}/{path}", headers=self.caller.headers)

    def shown(self, submission_id: str) -> dict[str, Any]:
        return answered(self.read(f"submissions/{submission_id}"), 200)

    def quota(self) -> dict[str, Any]:
        return answered(self.read(f"phases/{self.phase_id}/teams/{self.team_id}/quota"), 200)


def answered(reply: httpx.Response, status: int) -> dict[str, Any]:
    assert reply.status_code == status, reply.text
    body: dict[str, Any] = reply.json()
    return body


def refused(reply: httpx.Response) -> tuple[int, str]:
    return reply.status_code, reply.json()["code"]


def submitting(api: httpx.Client, platform: Platform, **rules: Any) -> Submitting:
    """A captain in a fresh phase with these rules; no stage reads what is sent to it."""
    return as_entrant(api, entrant_on(platform, **rules))


def as_entrant(api: httpx.Client, entrant: Entrant) -> Submitting:
    return Submitting(api, entrant.captain, entrant.phase_id, entrant.team_id)
