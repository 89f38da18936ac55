"""Following a job to its end by server-sent events, or by polling if there are none.

**Conventions.** An event's data is the job as in `GET /jobs/{id}`. A broken stream resumes with the id of the last
event. If the server is unreachable for longer than `AWAY_S`, following fails.
"""

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import httpx

from stone_client.api import Api, Patience
from stone_client.errors import JobFailedError, ServerFaultError, ServerRefusedError, ServerUnreachableError
from stone_client.progress import CountedStage, Report

AWAY_S = 120.0
SILENCE_S = 45.0
POLL_S = 1.0
TERMINAL = ("succeeded", "failed", "cancelled")
NO_STREAM = frozenset({404, 405, 406, 429, 501, 503})


@dataclass(frozen=True)
class Event:
    """One server-sent event; `id` is empty if it has none."""

    name: str
    id: str
    data: str


def follow(api: Api, job_id: str, progress: Report) -> Mapping[str, Any]:
    """Return the job after success. Raises `JobFailedError` for any other end, and what `Api.send` raises."""
    reported: dict[str, tuple[int, int]] = {}
    job: Mapping[str, Any] = {}
    for job in _states(api, job_id):
        _report(job, reported, progress)
    if job["state"] != "succeeded":
        raise JobFailedError(job)
    return job


def events(lines: Iterable[str]) -> Iterator[Event]:
    """Yield the events of a stream as the HTML standard parses it: fields until an empty line, comments skipped."""
    name, event_id = "message", ""
    data: list[str] = []
    for line in lines:
        key, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if not line:
            if data:
                yield Event(name, event_id, "\n".join(data))
            name, data = "message", []
        elif key == "event":
            name = value
        elif key == "id":
            event_id = value
        elif key == "data":
            data.append(value)


def _states(api: Api, job_id: str) -> Iterator[Mapping[str, Any]]:
    """Yield the job repeatedly until it has ended; the last value is its end."""
    job: Mapping[str, Any] = api.read(f"/jobs/{job_id}")
    yield job
    seen, patience = "", Patience(AWAY_S)
    while job["state"] not in TERMINAL:
        try:
            for event in _stream(api, job_id, seen):
                seen, job, patience = event.id or seen, _job_of(event, job), Patience(AWAY_S)
                yield job
        except (httpx.TransportError, ServerFaultError) as error:
            if not patience.wait(None):
                raise ServerUnreachableError(api.url, str(error) or type(error).__name__) from None
        except ServerRefusedError as error:
            if error.status not in NO_STREAM or not patience.wait(POLL_S):
                raise
        if job["state"] not in TERMINAL:  # no stream, or it ended: poll
            job = api.read(f"/jobs/{job_id}")
            yield job


def _stream(api: Api, job_id: str, seen: str) -> Iterator[Event]:
    headers = {"Accept": "text/event-stream", **({"Last-Event-ID": seen} if seen else {})}
    with api.stream(f"/jobs/{job_id}/events", headers, read_s=SILENCE_S) as answer:
        yield from events(answer.iter_lines())


def _job_of(event: Event, before: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the job after an event; omitted fields keep their values."""
    update = json.loads(event.data)
    return {**before, **update} if isinstance(update, dict) and "state" in update else before


def _report(job: Mapping[str, Any], reported: dict[str, tuple[int, int]], progress: Report) -> None:
    """Report changes: the stages of a run, or the job's own count, with the titles of the server's pages."""
    own = {"kind": job["kind"], "title": job.get("title"), **job["progress"]}
    stages, unit = (job["stages"], "jobs") if job.get("stages") else ((own,), "steps")
    for stage in stages:
        counts, title = (int(stage["done"]), int(stage["total"])), stage.get("title") or stage["kind"]
        if counts[1] and reported.get(title) != counts:
            reported[title] = counts
            progress(CountedStage(title, unit), *counts)
