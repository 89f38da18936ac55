"""Routes of topic profiles by robot platform, and the dry run that resolves one against a recording.

**Conventions.** A profile is its owner's, an administrator's not excepted. The dry run needs no job: it reads what the
recording's inspection kept.
"""

from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request, Response
from sqlalchemy import select
from sqlalchemy.orm import Session

from api import audit
from api.answers import refusals
from api.deps import Curator, PlatformDep, Reader
from api.errors import ApiError, NotFoundError
from api.etags import require_match, set_head
from api.paging import Page, PageDep, page
from api.schemas.base import PLAIN, IdPath
from api.schemas.sequences.calibrations import FindingItem, ProfileBody, ProfileItem, RolesAnswer
from api.visible import recording_of, sequence_of
from services.domain.sequences.profiles import keep_profile, lock_profile, profile_of, topics_of
from services.runtime.orm import CalibrationRow, ProfileRow, SequenceRow
from stone_recordings.topics.profiles import LONGEST_TOPIC, MOST_TOPICS, Candidate, bad_profile, resolve
from stone_recordings.topics.profiles import TopicProfile as Chosen

router = APIRouter(tags=["profiles"])
PlatformName = Annotated[str, Path(pattern=PLAIN, min_length=1, max_length=64, examples=["warthog-1"])]
Choice = Annotated[str, Query(pattern=PLAIN, max_length=64 + LONGEST_TOPIC)]
Choices = Annotated[list[Choice], Query(alias="topic", max_length=MOST_TOPICS, examples=[["lidar=/lidar_points"]])]


@router.get("/profiles", responses=refusals())
def list_profiles(caller: Reader, platform: PlatformDep, query: PageDep) -> Page[ProfileItem]:
    """List your profiles, newest first."""
    statement = select(ProfileRow).where(ProfileRow.owner_id == caller.user_id)
    with platform.database.reading() as session:
        return page(session, statement, ProfileRow.id.desc(), query).shown(ProfileItem.of)


@router.get("/profiles/{platform_name}", responses=refusals(404))
def show_profile(platform_name: PlatformName, caller: Reader, platform: PlatformDep, response: Response) -> ProfileItem:
    """Show the topics that you chose for a platform."""
    with platform.database.reading() as session:
        row = profile_of(session, caller.user_id, platform_name)
        if row is None:
            raise NotFoundError("profile", platform_name)
        shown = ProfileItem.of(row)
    return set_head(response, shown, tag=shown.revision)


@router.put("/profiles/{platform_name}", responses={201: {"model": ProfileItem}, **refusals(403, 412, 428)})
def save_profile(
    platform_name: PlatformName,
    body: ProfileBody,
    caller: Curator,
    platform: PlatformDep,
    request: Request,
    response: Response,
) -> ProfileItem:
    """Choose the topics of a platform: 201 for a new profile; replacing an existing profile requires If-Match."""
    topics = Chosen(body.topics, platform_name).topics
    with platform.database.transaction() as session:
        row = lock_profile(session, caller.user_id, platform_name)
        response.status_code = 200 if row is not None else 201
        if row is not None:
            require_match(request, row.revision)
        row = row or ProfileRow(owner_id=caller.user_id, platform=platform_name)
        if keep_profile(session, row, topics):
            audit.record(session, caller, "profile.save", row.id, facts={"platform": platform_name})
        shown = ProfileItem.of(row)
    return set_head(response, shown, tag=shown.revision)


@router.get(
    "/sequences/{sequence_id}/recordings/{recording_id}/roles",
    summary="Show the topic of each role",
    responses=refusals(404, 409),
)
def show_roles(
    sequence_id: IdPath,
    recording_id: IdPath,
    caller: Reader,
    platform: PlatformDep,
    choices: Choices = [],  # noqa: B006
) -> RolesAnswer:
    """Resolve the topics with the platform's profile and the given choices (`topic=PART=NAME`).

    Saves nothing. 409 until the recording is registered.
    """
    with platform.database.reading() as session:
        sequence = sequence_of(session, caller, sequence_id)
        inspection = recording_of(session, caller, sequence_id, recording_id).inspection
        if inspection is None:
            raise ApiError("conflict", "the recording is not registered; see its state and findings")
        saved, frames = topics_of(session, sequence), _channel_of_frame(session, sequence)
    made = dict(_choice(choice) for choice in choices)
    chosen = {part: topic for part, topic in saved.items() if topic not in made.values()} | made
    resolved = resolve(_candidates(inspection), Chosen(chosen, sequence.platform), frames)
    return RolesAnswer(
        platform=sequence.platform,
        chosen=chosen,
        channels=dict(resolved.channels),
        findings=[FindingItem(**finding.as_record()) for finding in resolved.findings],
    )


def _choice(text: str) -> tuple[str, str]:
    part, sign, topic = text.partition("=")
    if not sign:
        raise bad_profile(f"the choice {text[:40]!r}", "PART=TOPIC, such as lidar=/lidar_points")
    return part, topic


# Keys that inspections of earlier releases lack.
LATER_KEYS = ("frame_id", "point_count")


def _candidates(inspection: dict[str, Any]) -> list[Candidate]:
    keys = ("name", "type", "role", "count", "rate_hz")
    topics = inspection.get("topics", ())
    return [
        Candidate(**{key: topic[key] for key in keys}, **{key: topic[key] for key in LATER_KEYS if key in topic})
        for topic in topics
    ]


def _channel_of_frame(session: Session, sequence: SequenceRow) -> dict[str, str]:
    """Return the channel of each frame_id in the sequence's calibration."""
    if sequence.calibration_id is None:
        return {}
    sensors = session.get_one(CalibrationRow, sequence.calibration_id).sensors
    return {sensor["frame_id"].strip("/"): sensor["name"] for sensor in sensors if sensor.get("frame_id")}
