"""The first steps of each role, on the home page and in Help, and which of them are done.

**Conventions.** A step is done when its result exists, for any viewer; the list itself is not stored. Its role can open
its path. Each check reads one row at most.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from urllib.parse import urlsplit

from fastapi import Request
from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from api.deps import Caller, platform_of
from api.visible import benchmarks_of, sequences_of
from services.runtime.embedded.first_start import ADMINISTRATOR, first_password_file
from services.runtime.orm import (
    Activation,
    Benchmark,
    Dataset,
    LabelSet,
    Recording,
    SequenceRow,
    SplitMember,
    SubmissionRow,
    TeamMember,
    User,
)


@dataclass(frozen=True)
class FirstStep:
    """A step: its page, and its sentence."""

    title: str
    path: str
    text: str
    is_done: bool


def steps_for(session: Session, caller: Caller) -> tuple[FirstStep, ...]:
    """Return the steps of the caller's role, in order; none for visitors."""
    of_roles = {"participant": _participant, "curator": _curator, "administrator": _administrator}
    return tuple(of_roles[caller.role](session, caller)) if caller.role in of_roles else ()


def _participant(session: Session, caller: Caller) -> Iterator[FirstStep]:
    has_team = _is_any(session, select(TeamMember.team_id).where(TeamMember.user_id == caller.user_id))
    has_submitted = _is_any(session, select(SubmissionRow.id).where(SubmissionRow.user_id == caller.user_id))
    text = "Read its task and rules, download its manifest and inputs."
    if not _is_any(session, benchmarks_of(caller)):
        text = "There is none on this platform yet: ask an administrator."
    yield FirstStep("Choose a benchmark", "/benchmarks", text, has_team or has_submitted)
    yield FirstStep("Create or join a team", "/teams", "You submit as a team, even alone.", has_team)
    text = "Your zip is validated in the browser before anything is uploaded."
    yield FirstStep("Submit predictions", "/benchmarks", text, has_submitted)


def _curator(session: Session, caller: Caller) -> Iterator[FirstStep]:
    own = sequences_of(caller).order_by(SequenceRow.id.desc())
    recorded = own.join(Recording, Recording.sequence_id == SequenceRow.id)
    yield FirstStep(
        "Upload a recording",
        "/sequences/new",
        "ROS 2 or ROS 1 bags of one drive; an interrupted upload resumes.",
        _is_any(session, recorded),
    )
    has_calibration = _is_any(session, own.where(SequenceRow.calibration_id.is_not(None)))
    newest = session.scalars(own.limit(1)).first()
    at = f"/sequences/{newest.id}" if newest else "/sequences"
    text = "It contains the mounts of the robot's sensors and the intrinsics of its cameras."
    yield FirstStep("Assign a calibration", at, text, has_calibration)
    is_labelled = _is_any(session, own.join(LabelSet, LabelSet.sequence_id == SequenceRow.id))
    at = f"{at}/processing" if newest else "/sequences"
    yield FirstStep("Process the sequence", at, "When it is done, open its labels in 3D.", is_labelled)


def _administrator(session: Session, caller: Caller) -> Iterator[FirstStep]:
    others = select(User.id).where(User.is_active, User.id != caller.user_id)
    text = "Curators upload recordings, participants submit to benchmarks."
    yield FirstStep("Add users", "/admin/users", text, _is_any(session, others))
    text = "Upload and process recordings, import a published dataset, or run stone demo on this machine."
    yield FirstStep("Label sequences", "/sequences/new", text, _is_any(session, select(LabelSet.id)))
    text = "Assign each labelled sequence to train, val or test."
    yield FirstStep("Assign splits", "/dataset/splits", text, _is_any(session, select(SplitMember.sequence_id)))
    text = "A version never changes; each benchmark uses one."
    yield FirstStep("Publish a dataset version", "/dataset/new", text, _is_any(session, select(Dataset.id)))
    text = "Create it and its ground truth; teams can then submit."
    yield FirstStep("Create a benchmark", "/admin/benchmarks", text, _is_any(session, select(Activation.id)))


def _is_any(session: Session, found: Select[str] | Select[SequenceRow] | Select[Benchmark]) -> bool:
    return session.execute(found.limit(1)).first() is not None


# The place of the first administrator's password, for users who sign in on the platform's own machine.
#
# **Conventions.** Only the path is shown, never the password: all processes and tunnels of the machine can read a page,
# but only its owner can read the file.


LOCAL_NAME = "localhost"


@dataclass(frozen=True)
class FirstPassword:
    """The administrator's name and the file that holds the password of the first start."""

    administrator: str
    file: Path


def first_password_of(request: Request) -> FirstPassword | None:
    """Return the place; None unless the file exists and platform, address and reader are all on loopback."""
    settings = platform_of(request).settings
    file = first_password_file(settings)
    reader = request.client.host if request.client else ""
    hosts = (urlsplit(settings.api.url).hostname, request.url.hostname, reader)
    return FirstPassword(ADMINISTRATOR, file) if file and all(map(_is_loopback, hosts)) else None


def _is_loopback(host: str | None) -> bool:
    try:
        return ip_address(host or "").is_loopback
    except ValueError:
        return host == LOCAL_NAME
