"""OpenAPI responses for refusals: each status that a route may return, all with one problem schema.

**Conventions.** `responses=refusals(409, 412)` lists the statuses particular to a route. `api/openapi.py` adds the
statuses that follow from its form: 401 if it requires a caller, 422 if it reads input, 429 and 503 always.
"""

from typing import Any

from api.problems import MEDIA_TYPE
from api.statuses import phrase_of

Responses = dict[int | str, dict[str, Any]]
SCHEMA = {"$ref": "#/components/schemas/Problem"}


def refusal(status: int) -> dict[str, Any]:
    """Return the OpenAPI response of this status."""
    return {"description": phrase_of(status), "content": {MEDIA_TYPE: {"schema": SCHEMA}}}


def refusals(*statuses: int) -> Responses:
    """Return the OpenAPI responses of these refusal statuses."""
    return {status: refusal(status) for status in statuses}
