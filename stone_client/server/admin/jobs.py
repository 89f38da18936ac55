"""Any job of a server, by its id or short id."""

from itertools import islice
from typing import Any

from stone_base.errors import Refused
from stone_client.api import Api
from stone_client.server.ids import MOST_CANDIDATES, is_id, is_short_id, whole_id


def job_id_named(api: Api, named: str) -> str:
    """Return the id of the job with this id or short id. Raises `not_found`, `ambiguous_id`."""
    if is_id(named):
        return named
    matching: list[dict[str, Any]] = []
    if is_short_id(named):
        matching = list(islice(api.pages("/admin/jobs", id_part=named), MOST_CANDIDATES + 1))
    job_id = whole_id(named, (str(job["id"]) for job in matching))
    if job_id is None:
        raise Refused("not_found", f"{named[:80]!r} is not a job id; `stone admin jobs list` lists them")
    return job_id
