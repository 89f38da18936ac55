"""Following a run to its end, with a progress bar for every stage."""

from typing import Any

from stone_client.api import Api
from stone_client.progress import reported
from stone_client.server.job_following import follow
from stone_client.server.sequences import Item


def watch_run(api: Api, job: Item) -> dict[str, Any]:
    """Return the job after success. Raises `JobFailedError` for any other end."""
    with reported() as progress:
        return dict(follow(api, job["id"], progress))
