"""Submission of a file: create, upload, finalise and follow; a repeated call resumes.

**Conventions.** The client stores nothing: it looks up the team's submission of the same bytes under the same name. So
a restarted client continues, and a file is never scored twice by accident.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from time import sleep
from typing import Any

from stone_base.errors import StoneError
from stone_client.api import Api
from stone_client.confirmation import PermanentAct
from stone_client.errors import JobFailedError, ServerRefusedError
from stone_client.files.tus import LocalFile, Purpose, hashed, upload_file
from stone_client.progress import Report
from stone_client.server.job_following import POLL_S, follow
from stone_client.server.sequences import Item

PURPOSE = "submission"
GONE_ON = ("draft", "queued", "scoring", "scored", "valid", "invalid")
SETTLED = ("scored", "valid", "invalid", "failed", "cancelled")
NOT_OURS = 404


@dataclass(frozen=True)
class SubmissionDescription:
    """The description of a submitted file: phase, team, method. `kind`: entry, baseline or validation."""

    phase_id: str
    team_id: str
    method: str
    modality: str
    description: str = ""
    kind: str = "entry"


class SubmissionInvalidError(StoneError):
    """The file was checked and is not valid; `code` is the code of the first problem, `report` the server's report."""

    code = "invalid"

    def __init__(self, report: Mapping[str, Any]) -> None:
        self.report = dict(report)
        first: Mapping[str, Any] = next(iter(report["errors"]), {})
        self.code = str(first.get("code") or type(self).code)
        where = (
            f"; the first is {first['file']}: expected {first['expected']}, found {first['actual']}" if first else ""
        )
        super().__init__(f"submission {report['submission_id']} has {report['errors_total']} problems{where}")


class SubmissionEndedError(StoneError):
    """The submission failed through no fault of the file, or was cancelled; `code` is the code of its failure."""

    code = "not_scored"

    def __init__(self, submission: Item) -> None:
        self.submission = dict(submission)
        failure = submission["failure"] or {}
        self.code = str(failure.get("code") or submission["state"])
        why = failure.get("sentence") or f"it was {submission['state']}"
        super().__init__(
            f"submission {submission['id']} {submission['state']}: {why}; it does not count towards the quota"
        )


def submit(api: Api, path: Path, entry: SubmissionDescription, progress: Report, *, again: bool = False) -> Item:
    """Send and finalise the file at `path`, and return its submission; continue an existing one unless `again`.

    Raises what `Api.send` raises, and `file_changed`.
    """
    local = hashed(path, progress)
    submission = (None if again else _existing_submission(api, entry, local)) or _announced(api, entry, local)
    submission = _described(api, submission, entry)
    if submission["state"] != "draft":
        return submission
    upload_id = upload_file(api, local, Purpose(PURPOSE, submission["id"]), progress)
    return api.create(f"/submissions/{submission['id']}/finalize", {"upload_id": upload_id})


def settled(api: Api, submission: Item, progress: Report) -> Item:
    """Return the submission after it is scored or found valid.

    Raises `SubmissionInvalidError`, `SubmissionEndedError`, and what `Api.send` raises.
    """
    if submission["state"] not in SETTLED and submission["job_id"]:
        _follow(api, str(submission["job_id"]), progress)
    submission = _ended(api, str(submission["id"]), progress)
    if submission["state"] == "invalid":
        raise SubmissionInvalidError(api.read(f"/submissions/{submission['id']}/validation-report"))
    if submission["state"] not in ("scored", "valid"):
        raise SubmissionEndedError(submission)
    return submission


def withdrawal(api: Api, submission_id: str) -> PermanentAct:
    """Return the act of withdrawing this submission, with its id, method, track and date."""
    entry = api.read(f"/submissions/{submission_id}")
    sent = (entry["finalized_at"] or entry["created_at"])[:16]
    named = f"{entry['method']}, {entry['modality']}, sent {sent}"
    effect = "it leaves every board permanently and still counts towards the quota"
    return PermanentAct(f"withdraw submission {entry['id']} ({named})", effect)


def withdraw(api: Api, submission_id: str, reason: str) -> Item:
    """Withdraw a submission from every board permanently."""
    return api.create(f"/submissions/{submission_id}/withdraw", {"reason": reason})


def _existing_submission(api: Api, entry: SubmissionDescription, local: LocalFile) -> Item | None:
    """Return the newest submission of this file to this phase by this team, with this name and track."""
    wanted = (local.sha256, local.size_bytes, entry.method, entry.modality)
    mine = api.pages("/submissions", phase_id=entry.phase_id, team_id=entry.team_id, kind=entry.kind)
    for item in mine:
        same = tuple(item[key] for key in ("sha256", "size_bytes", "method", "modality")) == wanted
        if same and item["state"] in GONE_ON and item["withdrawn_at"] is None:
            return api.read(f"/submissions/{item['id']}")
    return None


def _announced(api: Api, entry: SubmissionDescription, local: LocalFile) -> Item:
    body: dict[str, Any] = {"team_id": entry.team_id, "method": entry.method, "modality": entry.modality}
    body |= {"description": entry.description, "sha256": local.sha256, "size_bytes": local.size_bytes}
    if entry.kind == "validation":
        draft: Item = api.create(f"/phases/{entry.phase_id}/validations", body)
    else:
        draft = api.create(f"/phases/{entry.phase_id}/submissions", {**body, "kind": entry.kind})
    return draft


def _described(api: Api, submission: Item, entry: SubmissionDescription) -> Item:
    """Return the submission with the given description, if there is one."""
    if not entry.description or submission["description"] == entry.description:
        return submission
    own, match = f"/submissions/{submission['id']}", {"If-Match": f'"{submission["revision"]}"'}
    changed: Item = api.send("PATCH", own, json={"description": entry.description}, headers=match).json()
    return changed


def _follow(api: Api, job_id: str, progress: Report) -> None:
    """Follow the run if it is visible; a failure is reported by the submission instead."""
    try:
        follow(api, job_id, progress)
    except JobFailedError:
        return
    except ServerRefusedError as error:
        if error.status != NOT_OURS:
            raise


def _ended(api: Api, submission_id: str, progress: Report) -> Item:
    """Poll the submission until it has ended, and return it."""
    while True:
        submission: Item = api.read(f"/submissions/{submission_id}")
        if submission["state"] in SETTLED:
            return submission
        if counts := submission["progress"]:
            progress("score", int(counts["done"]), int(counts["total"]))
        sleep(POLL_S)
