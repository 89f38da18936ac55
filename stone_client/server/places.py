"""Recordings and datasets that a server reads in place."""

from dataclasses import dataclass
from pathlib import PurePosixPath

from stone_base.errors import Refused
from stone_client.api import Api
from stone_client.progress import Report
from stone_client.server.job_following import follow
from stone_client.server.sequences import Item, registered


@dataclass(frozen=True)
class Place:
    """A bag or an archive below a root of the server."""

    root: str
    path: str
    with_pictures: bool = False

    def __str__(self) -> str:
        return f"{self.root}:{self.path}"

    @property
    def called(self) -> str:
        """The default name of its sequence."""
        return PurePosixPath(self.path).name.partition(".")[0]


def place_named(text: str, *, with_pictures: bool) -> Place:
    """Return the place `root:path`. Raises `bad_place`."""
    root, colon, path = text.partition(":")
    if not (root and colon and path):
        raise Refused("bad_place", f"{text[:200]!r} is not a path on the server; write it as nas:2026/run.mcap")
    return Place(root, path, with_pictures)


def add_in_place(api: Api, sequence: Item, place: Place, progress: Report) -> Item:
    """Request that the server reads the bag; an existing recording of the sequence is reused.

    Raises the code of a refused recording's first finding, and `JobFailedError`.
    """
    wanted = {"root": place.root, "path": place.path}
    for recording in api.pages(f"/sequences/{sequence['id']}/recordings"):
        if recording["place"] == wanted and recording["state"] != "refused":
            return registered(api, sequence, recording)
    body = {"in_place": {**wanted, "with_pictures": place.with_pictures}}
    accepted = api.create(f"/sequences/{sequence['id']}/recordings", body)
    follow(api, accepted["job"]["id"], progress)
    return registered(api, sequence, accepted["recording"])
