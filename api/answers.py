"""OpenAPI responses for refusals: each status a route may answer with, all as one problem document.

**Conventions.** `responses=refusals(409, 412)` names what is particular to a route. What follows from its form (401
where it asks for a caller, 422 where it reads anything, 429 and 503 always) is added to the whole document by
`api/openapi.py`.
"""

from typing import Any

from api.problems import MEDIA_TYPE
from api.statuses import phrase_of

Responses = dict[int | str, dict[str, Any]]
SCHEMA = {"$ref": "#/components/schemas/Problem"}


def refusal(status: int) -> dict[str, Any]:
    """The OpenAPI response of this status."""
    return {"description": phrase_of(status), "content": {MEDIA_TYPE: {"schema": SCHEMA}}}


def refusals(*statuses: int) -> Responses:
    """The statuses a route may refuse with."""
    return {status: refusal(status) for status in statuses}
