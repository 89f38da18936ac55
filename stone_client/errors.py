"""Errors of commands that talk to a server.

**Conventions.** A server's own code and sentence are passed on as they are; a fault has the id of the request, which
the server's administrator can look up.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stone_base.errors import Refused, StoneError

MOST_FINDINGS = 5
FAULT = 500
OWN_SENTENCES = {
    "unauthenticated": "the server does not accept the token, which is unknown, expired or revoked; "
    "run `stone auth login`, or set STONE_TOKEN",
}
"""Sentences of the client by the code of a server whose own sentence is for programs."""


class ServerRefusedError(StoneError):
    """The server answered with a problem; `code` is its code, not the class's."""

    code = "server_refused"

    def __init__(self, status: int, problem: Mapping[str, Any], retry_after_s: float | None = None) -> None:
        self.status, self.problem, self.retry_after_s = status, dict(problem), retry_after_s
        self.code = str(problem.get("code") or type(self).code)  # the server names the reason
        sentence = OWN_SENTENCES.get(self.code) or str(
            problem.get("detail") or problem.get("title") or f"the server answered {status}"
        )
        request_id = problem.get("request_id") if status >= FAULT else None  # of use to an administrator alone
        super().__init__(sentence + _findings(problem) + (f" (request {request_id})" if request_id else ""))


class ServerFaultError(StoneError):
    """The answer is not one of the platform: a fault, a proxy's page, another program on that port."""

    code = "server_fault"

    def __init__(self, status: int, url: str, text: str) -> None:
        said = text.strip()[:200]
        super().__init__(f"{url} answered {status} without a problem description{f': {said}' if said else ''}")
        self.status = status


class ServerUnreachableError(StoneError):
    """Nothing answers at the URL, or the connection kept breaking."""

    code = "server_unreachable"

    def __init__(self, url: str, reason: str) -> None:
        super().__init__(f"{url} cannot be reached: {reason}; is it running (`stone serve`), and is the URL right?")


def file_changed(path: Path) -> Refused:
    return Refused(
        "file_changed",
        f"{path} changed while it was uploaded; is it still being written? Upload it again when it is complete",
    )


class JobFailedError(StoneError):
    """A job ended badly; `code` is that of its failure."""

    code = "job_failed"

    def __init__(self, job: Mapping[str, Any]) -> None:
        failure = job.get("failure") or {}
        self.job = dict(job)
        self.code = str(failure.get("code") or job["state"])  # the failure names the reason
        reason = failure.get("sentence") or job.get("cancel_reason") or f"it was {job['state']}"
        super().__init__(f"{job['kind']} {job['id']} {job['state']}: {reason}")


def unknown_subject(subject: str) -> Refused:
    return Refused(
        "not_found",
        f"no sequence and no job of yours is called {subject!r}; `stone sequence list` lists your sequences",
    )


def damaged_download(path: str, found: str, promised: str) -> Refused:
    return Refused("damaged_download", f"{path} has sha256 {found}, expected {promised or 'none'}; download it again")


def _findings(problem: Mapping[str, Any]) -> str:
    """The first few things that are wrong, where the server names several."""
    found = problem.get("errors") or []
    said = [
        (str(one.get("where", "")), str(one.get("detail") or one.get("expected") or one.get("code", "")))
        for one in found
    ]
    new = [f"{where}: {detail}" for where, detail in said[:MOST_FINDINGS] if detail not in str(problem.get("detail"))]
    return f": {'; '.join(new)}" if new else ""
