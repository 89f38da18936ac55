"""Entries of the audit log as sentences: actor, act and object, with the object's name and page.

**Conventions.** An act is `noun.verb`. The name of a deleted object comes from the entry's facts, else it is the end of
its id. An act missing in the table of verbs is shown as its code.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, cast

from sqlalchemy import select
from sqlalchemy.orm import Session

from api.schemas.audit import AuditLine
from services.runtime.jobs.queries import title_of
from services.runtime.orm import (
    Benchmark,
    CalibrationRow,
    Dataset,
    Job,
    LabelSet,
    Phase,
    Recording,
    SequenceRow,
    SubmissionRow,
    Team,
    User,
)

VERBS: Mapping[str, str] = {
    "user.add": "added the user",
    "user.change": "changed the user",
    "user.password": "set a password of the user",
    "user.erase": "erased the user",
    "user.token_revoke": "revoked a token of the user",
    "user.credentials_revoke": "revoked all credentials of the user",
    "session.open": "signed in as",
    "session.close": "signed out as",
    "session.close_others": "signed out other browsers of",
    "token.issue": "issued a token",
    "token.revoke": "revoked a token",
    "device.approve": "approved a device",
    "device.deny": "denied a device",
    "sequence.create": "created the sequence",
    "sequence.change": "changed the sequence",
    "sequence.delete": "deleted the sequence",
    "sequence.calibrate": "assigned a calibration to the sequence",
    "sequence.process": "started processing of the sequence",
    "recording.add": "added the recording",
    "recording.delete": "removed the recording",
    "calibration.add": "added the calibration",
    "label_set.activate": "activated the label set",
    "label_set.delete": "deleted the label set",
    "label_comparison.create": "compared two label sets",
    "export.create": "started the export",
    "export.delete": "deleted the export",
    "dataset.create": "published the dataset version",
    "dataset.inputs": "started the inputs of the dataset version",
    "dataset_import.create": "started the import",
    "dataset_import.delete": "deleted the import",
    "splits.put": "changed the draft splits",
    "benchmark.create": "created the benchmark",
    "benchmark.change": "changed the benchmark",
    "phase.create": "created the phase",
    "phase.change": "changed the phase",
    "phase.activate": "activated an evaluation version of the phase",
    "phase.abandon": "abandoned an evaluation version of the phase",
    "phase.rescore": "started a re-score of the phase",
    "phase.inputs": "started the inputs of the phase",
    "ground_truth.create": "started a ground truth",
    "reported.put": "changed reported results of the phase",
    "submission.announce": "started the submission",
    "submission.finalize": "submitted",
    "submission.describe": "changed the description of the submission",
    "submission.cancel": "cancelled the submission",
    "submission.withdraw": "withdrew the submission",
    "submission.hide": "hid the submission",
    "submission.unhide": "showed the submission again",
    "team.found": "created the team",
    "team.invite": "invited to the team",
    "team.uninvite": "withdrew an invitation into the team",
    "team.join": "joined the team",
    "team.leave": "left the team",
    "team.remove": "removed a member of the team",
    "team.hand_over": "changed the captain of the team",
    "team.grant": "granted scorings to the team",
    "job.cancel": "cancelled the job",
    "job.retry": "retried the job",
    "job.terminate": "terminated the job",
    "profile.save": "saved the topic profile",
    "alarm.dismiss": "dismissed the alarm",
    "queue.pause": "paused the queue",
    "queue.drain": "drained the queue",
    "queue.resume": "resumed the queue",
    "notifications.choose": "chose notifications of",
    "notifications.email": "set the e-mail address of",
    "notifications.email_removed": "removed the e-mail address of",
    "notifications.email_verified": "verified the e-mail address of",
    "notifications.webhook": "set the webhook of",
    "notifications.webhook_removed": "removed the webhook of",
    "notifications.webhook_secret": "renewed the webhook's secret of",
}


@dataclass(frozen=True)
class Thing:
    """The subject of an entry: its name, and its page, empty if it has none."""

    name: str
    path: str = ""


@dataclass(frozen=True)
class DescribedLine:
    """An entry with its sentence: the actor, then `verb`, then the thing."""

    line: AuditLine
    verb: str
    thing: Thing


Found = Callable[[Any], Thing]
THINGS: Mapping[str, tuple[Any, Found]] = {
    "user": (User, lambda row: Thing(row.name, f"/admin/users/{row.id}")),
    "notifications": (User, lambda row: Thing(row.name, f"/admin/users/{row.id}")),
    "session": (User, lambda row: Thing(row.name, f"/admin/users/{row.id}")),
    "sequence": (SequenceRow, lambda row: Thing(row.name, f"/sequences/{row.id}")),
    "recording": (Recording, lambda row: Thing(row.filename, f"/sequences/{row.sequence_id}/recordings")),
    "calibration": (
        CalibrationRow,
        lambda row: Thing(f"{row.name}, version {row.version}", f"/calibrations/{row.id}"),
    ),
    "label_set": (
        LabelSet,
        lambda row: Thing(row.parameters.get("profile") or row.id[-8:], f"/sequences/{row.sequence_id}/label-sets"),
    ),
    "dataset": (Dataset, lambda row: Thing(row.name, f"/dataset?version={row.name}")),
    "benchmark": (Benchmark, lambda row: Thing(row.name, f"/benchmarks/{row.name}")),
    "phase": (Phase, lambda row: Thing(row.title or row.name)),
    "reported": (Phase, lambda row: Thing(row.title or row.name)),
    "submission": (SubmissionRow, lambda row: Thing(row.method, f"/submissions/{row.id}")),
    "team": (Team, lambda row: Thing(row.name, f"/teams/{row.id}")),
    "job": (Job, lambda row: Thing(title_of(row.kind), f"/admin/jobs/{row.id}")),
}


def describe(session: Session, lines: Iterable[AuditLine]) -> list[DescribedLine]:
    """Return the entries as sentences, with one statement per kind of object."""
    kept = list(lines)
    wanted = defaultdict[str, set[str]](set)
    for line in kept:
        wanted[_noun(line)].add(line.subject_id)
    objects = {
        (noun, row_found.id): as_thing(row_found)
        for noun, (row, as_thing) in THINGS.items()
        for row_found in _rows(session, row, wanted[noun])
    }
    return [
        DescribedLine(line, VERBS.get(line.act, line.act), objects.get((_noun(line), line.subject_id)) or _gone(line))
        for line in kept
    ]


def _noun(line: AuditLine) -> str:
    return line.act.partition(".")[0]


def _rows(session: Session, row: Any, ids: set[str]) -> Iterable[Any]:
    return cast("Iterable[Any]", session.scalars(select(row).where(row.id.in_(ids)))) if ids else ()


def _gone(line: AuditLine) -> Thing:
    """Return the object from the entry's own facts."""
    named = next((line.facts[key] for key in ("name", "filename", "method", "format") if line.facts.get(key)), "")
    return Thing(str(named) or line.subject_id[-8:])
