"""A run or job of the server."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stone_client.api import Api
from stone_client.progress import Report
from stone_client.server.job_following import follow


class Run:
    """A run or a job of the server, such as the labelling of a sequence."""

    def __init__(self, api: Api, item: Mapping[str, Any], progress: Report) -> None:
        self._api, self._item, self._progress = api, item, progress

    @property
    def id(self) -> str:
        """The id, as `stone sequence status` and `stone sequence watch` take it."""
        return str(self._item["id"])

    @property
    def state(self) -> str:
        """Read its state from the server: queued, running, succeeded, failed or cancelled."""
        self._item = self._api.read(f"/jobs/{self.id}")
        return str(self._item["state"])

    @property
    def record(self) -> Mapping[str, Any]:
        """The API's JSON object, as last read."""
        return self._item

    def wait(self) -> Run:
        """Return this run once it has succeeded. Raises `JobFailedError` with the code of its failure."""
        self._item = follow(self._api, self.id, self._progress)
        return self

    def __repr__(self) -> str:
        return f"<Run {self.id} {self._item['kind']} {self._item['state']}>"
