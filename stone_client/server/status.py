"""The status of a server's sequences, of one sequence or of a job, as a record and as tables."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from rich.table import Table

from stone_client.api import Api
from stone_client.server.sequences import Item, find_job, find_subject
from stone_client.tables import DASH, plain_table, safe_text, show

LAST_LINES = 12


@dataclass(frozen=True)
class ServerStatus:
    """A status; `record` is printed by `--json`, and the tables show the same."""

    record: dict[str, Any]
    tables: tuple[Table, ...]

    def show(self) -> None:
        for table in self.tables:
            show(table)


def server_status_of(api: Api, subject: str | None) -> ServerStatus:
    """Return the status of all visible sequences, of one sequence, or of a job. Raises `not_found`."""
    if subject is None:
        items = list(api.pages("/sequences"))
        return ServerStatus({"sequences": items}, (_sequences_table(api.url, items),))
    kind, item = find_subject(api, subject)
    if kind == "job":
        return _job_status(item, _last_lines(api, f"/jobs/{item['id']}/logs"))
    sequence = item
    recordings = list(api.pages(f"/sequences/{sequence['id']}/recordings"))
    tables = [_sequences_table(api.url, [sequence]), _recordings_table(recordings), *_later_tables(sequence)]
    if sequence["job"] is not None:
        tables.append(_job_table(find_job(api, sequence["job"]["id"])))
    return ServerStatus({**sequence, "recordings": recordings}, tuple(tables))


def any_job_status_of(api: Api, job_id: str) -> ServerStatus:
    """Return the status of any job, for administrators."""
    path = f"/admin/jobs/{job_id}"
    return _job_status(api.read(path), _last_lines(api, f"{path}/logs"))


def _job_status(job: Item, lines: list[Item]) -> ServerStatus:
    return ServerStatus({**job, "lines": lines}, (_job_table(job), *_lines_tables(lines)))


def _sequences_table(url: str, items: Iterable[Item]) -> Table:
    table = plain_table(f"sequences on {url}", "name", "recordings", "newest run", "labelled frames")
    for item in items:
        run = f"{item['job']['kind']} {item['job']['state']}" if item["job"] else DASH
        frames = str(item["labels"]["frames"]) if item["labels"] else DASH
        table.add_row(safe_text(item["name"]), str(item["recordings"]), run, frames)
    return table


def _recordings_table(items: Iterable[Item]) -> Table:
    table = plain_table("recordings", "file", "bytes", "state", "sha256 (first 16 digits)")
    for item in items:
        table.add_row(safe_text(item["filename"]), f"{item['size_bytes']:,}", item["state"], item["sha256"][:16])
    return table


def _later_tables(sequence: Item) -> Iterable[Table]:
    """Return the tables of newer fields, none for a server of an earlier release."""
    later = sequence.get("later_recordings")
    if later:
        table = plain_table("labels predate these recordings", "file", "made again")
        for name in later["names"]:
            table.add_row(safe_text(name), safe_text(later["why_not"] or "by itself"))
        yield table


def _job_table(job: Item) -> Table:
    title = f"{job.get('title') or job['kind']} {job['id']}: {_state_of(job)}{_left_of(job)}"
    table = plain_table(title, "stage", "done", "of", "running", "failed")
    own = {"kind": job["progress"]["stage"] or job["kind"], "running": "", "failed": "", **job["progress"]}
    for stage in job["stages"] or (own,):
        counts = (str(stage[key]) for key in ("done", "total", "running", "failed"))
        table.add_row(safe_text(stage.get("title") or stage["kind"]), *counts)
    return table


def _state_of(job: Item) -> str:
    failure, is_cancelled = job["failure"], job["state"] == "cancelled"
    if failure:
        return safe_text(f"{job['state']}, {failure['code']}: {failure['sentence']}")
    return safe_text(
        f"{job['state']}: {job['cancel_reason']}" if is_cancelled and job["cancel_reason"] else job["state"]
    )


def _left_of(job: Item) -> str:
    left_s = job["progress"].get("eta_s")
    return "" if left_s is None else f", about {left_s:g} s left"


def _last_lines(api: Api, path: str) -> list[Item]:
    """Return the job's last log lines; long logs are read page by page from the start."""
    lines: list[Item] = []
    after: dict[str, str | int] = {}
    while True:
        page = api.read(path, limit=1000, **after)
        lines = [*lines, *page["items"]][-LAST_LINES:]
        if not page["items"] or page["next"] is None:
            return lines
        after = {"after": page["next"]}


def _lines_tables(lines: list[Item]) -> Iterable[Table]:
    if lines:
        table = plain_table("last lines", "logged", "level", "line")
        for line in lines:
            table.add_row(line["logged_at"][11:19], line["level"], safe_text(line["event"]))
        table.columns[2].justify = "left"
        yield table
