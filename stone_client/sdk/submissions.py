"""A submission to a benchmark."""

from __future__ import annotations

from stone_client.api import Api
from stone_client.progress import Report
from stone_client.sdk.records import Item, Part, Ratios, Results, record_of
from stone_client.sdk.tables import Table
from stone_client.server import scores
from stone_client.server import submission as submitting


class Submission:
    """One submission: its `state`, and after scoring its `scores`, `results` and breakdowns."""

    def __init__(self, api: Api, item: Item, progress: Report) -> None:
        self._api, self._item, self._progress = api, item, progress

    @property
    def id(self) -> str:
        """The id, as `stone benchmark results` takes it."""
        return str(self._item["id"])

    @property
    def method(self) -> str:
        """The name of its method."""
        return str(self._item["method"])

    @property
    def record(self) -> Item:
        """The API's JSON object, as last read."""
        return self._item

    @property
    def state(self) -> str:
        """Read its state from the server: draft, queued, scoring, then scored, valid, invalid, failed or cancelled."""
        self._item = self._api.read(f"/submissions/{self.id}")
        return str(self._item["state"])

    def wait(self) -> Submission:
        """Return this submission, scored or valid. Raises `SubmissionInvalidError`, `SubmissionEndedError`."""
        self._item = submitting.settled(self._api, self._item, self._progress)
        return self

    @property
    def scores(self) -> Ratios:
        """The ratios by name: miou, iou_occ, iou_t, iou_p, iou_n; None if undefined."""
        return self.results.total

    @property
    def results(self) -> Results:
        """Totals, intervals, supports and extra figures, as far as they are visible to the caller."""
        return record_of(Results, scores.read_results(self._api, self.id))

    def breakdown(self, by: str) -> Table[Part]:
        """Return the result by sequence, environment, illumination or distance."""
        parts = scores.read_breakdown(self._api, self.id, by)["parts"]
        return Table(Part, (record_of(Part, part) for part in parts))

    def withdraw(self, reason: str = "") -> None:
        """Withdraw it from every board permanently; it still counts towards the quota."""
        self._item = submitting.withdraw(self._api, self.id, reason)

    def __repr__(self) -> str:
        return f"<Submission {self.id} {self._item['method']} {self._item['state']}>"
