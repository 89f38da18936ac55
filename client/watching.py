"""Stays with a run until it has ended, with a bar for every stage."""

from typing import Any

from client.api import Api
from client.following import follow
from client.progress import reported
from client.remote import Item


def watch_run(api: Api, job: Item) -> dict[str, Any]:
    """The job as it ended well. Raises `JobFailedError` for any other end."""
    with reported() as progress:
        return dict(follow(api, job["id"], progress))
