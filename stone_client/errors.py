"""Errors of commands that talk to a server.

**Conventions.** The server's code and sentence are passed on unchanged. A fault includes the request id, for the
server's administrator.
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
"""The client's own sentences for codes whose server sentence addresses programs."""


class ServerRefusedError(StoneError):
    """The server answered with a problem; `code` is its code, not the class's."""

    code = "server_refused"

    def __init__(self, status: int, problem: Mapping[str, Any], retry_after_s: float | None = None) -> None:
        self.status, self.problem, self.retry_after_s = status, dict(problem), retry_after_s
        self.code = str(problem.get("code") or type(self).code)
        sentence = OWN_SENTENCES.get(self.code) or str(
            problem.get("detail") or problem.get("title") or f"the server answered {status}"
        )
        request_id = problem.get("request_id") if status >= FAULT else None  # useful only to an administrator
        super().__init__(sentence + _findings(problem) + (f" (request {request_id})" if request_id else ""))


class ServerFaultError(StoneError):
    """The answer is not from the platform: a fault, a proxy's page, or another program on that port."""

    code = "server_fault"

    def __init__(self, status: int, url: str, text: str) -> None:
        excerpt = text.strip()[:200]
        super().__init__(f"{url} answered {status} without a problem description{f': {excerpt}' if excerpt else ''}")
        self.status = status


class ServerUnreachableError(StoneError):
    """No server answers at the URL, or the connection kept breaking."""

    code = "server_unreachable"

    def __init__(self, url: str, reason: str) -> None:
        super().__init__(f"{url} cannot be reached: {reason}; is it running (`stone serve`), and is the URL right?")


def file_changed(path: Path) -> Refused:
    return Refused(
        "file_changed",
        f"{path} changed while it was uploaded; is it still being written? Upload it again when it is complete",
    )


class JobFailedError(StoneError):
    """A job did not succeed; `code` is the code of its failure."""

    code = "job_failed"

    def __init__(self, job: Mapping[str, Any]) -> None:
        failure = job.get("failure") or {}
        self.job = dict(job)
        self.code = str(failure.get("code") or job["state"])
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
    """Return the first few findings of a problem that lists several."""
    errors = problem.get("errors") or []
    sentences = [
        (str(error.get("where", "")), str(error.get("detail") or error.get("expected") or error.get("code", "")))
        for error in errors
    ]
    new = [
        f"{where}: {detail}" for where, detail in sentences[:MOST_FINDINGS] if detail not in str(problem.get("detail"))
    ]
    return f": {'; '.join(new)}" if new else ""
