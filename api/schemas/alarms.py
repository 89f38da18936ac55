"""Alarms and grants over the wire."""

from datetime import datetime
from typing import Annotated, Any

from pydantic import Field

from api.schemas.base import ID_EXAMPLE, Answer, Body, IdText, Reason, example

MOST_SCORINGS = 10_000
ALARM_EXAMPLE: dict[str, Any] = {
    "id": ID_EXAMPLE,
    "phase_id": ID_EXAMPLE,
    "kind": "equal_content",
    "subject": ID_EXAMPLE,
    "facts": {
        "submission_id": ID_EXAMPLE,
        "team_id": ID_EXAMPLE,
        "team": "Forest",
        "method": "VoxelNet",
        "others": [{"submission_id": ID_EXAMPLE, "team_id": ID_EXAMPLE, "team": "Lake", "method": "Ours"}],
    },
    "created_at": "2026-05-03T09:12:44.120000Z",
    "dismissed_at": None,
}


class AlarmItem(Answer):
    """Something to look at: `equal_content` and `near_equal_teams` across teams, `near_equal` within one team's day.

    `facts` name the submissions; `differing_ratio` is the least share of the evaluated voxels by which two differ.
    """

    model_config = example(**ALARM_EXAMPLE)

    id: str
    phase_id: str
    kind: str
    subject: str
    facts: dict[str, Any]
    created_at: datetime
    dismissed_at: datetime | None


class GrantBody(Body):
    """How many scorings more a team may have in a phase (negative: take back), and why."""

    model_config = example(phase_id=ID_EXAMPLE, scorings=2, reason="the platform was away at the deadline")

    phase_id: IdText
    scorings: Annotated[int, Field(ge=-MOST_SCORINGS, le=MOST_SCORINGS)]
    reason: Reason


class GrantItem(Answer):
    """A grant as it stands in the ledger, and what the team may have scored now.

    `next_at` is when the next submission may be finalised, null for never; `limit` and `total_left` are null where
    there is no limit.
    """

    model_config = example(
        id=ID_EXAMPLE,
        phase_id=ID_EXAMPLE,
        team_id=ID_EXAMPLE,
        scorings=2,
        limit=5,
        used=3,
        reserved=0,
        total_left=7,
        next_at="2026-05-03T09:12:44.120000Z",
        created_at="2026-05-03T09:12:44.120000Z",
    )

    id: str
    phase_id: str
    team_id: str
    scorings: int
    limit: int | None
    used: int
    reserved: int
    total_left: int | None
    next_at: datetime | None
    created_at: datetime
