"""The clients of `benchmarks.load`: a process with a connection per client, alternating requests and pauses.

**Conventions.** `python -m benchmarks.load.clients PLAN.json OUT.json`. Durations are logged by request name, in
seconds on the client's clock; an unexpected answer is an error with its text.
"""

import asyncio
import base64
import json
import random
import sys
import time
from collections import defaultdict
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

PREFIX = "/api/v1"
TUS = {"Tus-Resumable": "1.0.0"}
BYTES = {**TUS, "Content-Type": "application/offset+octet-stream"}
PIECE_BYTES = 2**20
PIECES = 4
POLL_S = 2.0
MOST_ERRORS = 20
READS = (
    ("list sequences", "/sequences", 30),
    ("list jobs", "/jobs", 20),
    ("list sequences again (ETag)", "/sequences", 15),
    ("a sequence", "/sequences/{sequence}", 15),
    ("the board", "/benchmarks/{benchmark}/phases/{phase}/leaderboard", 10),
    ("me", "/me", 10),
)


@dataclass(frozen=True)
class LoadPlan:
    """The clients' requests and their duration, from the address `source`.

    `readers` request lists, `uploaders` send files, and each of the `submitters` has a submission scored.
    """

    port: int
    seconds: float
    pause_s: float
    readers: int
    uploaders: int
    submitters: int
    secrets: tuple[str, ...]
    captains: tuple[tuple[str, str], ...]
    sequence: str
    benchmark: str
    phase: str
    phase_id: str
    zip_path: str
    source: str = "127.0.0.1"


@dataclass
class LoadLog:
    """Durations in seconds by request name; texts of errors."""

    waited_s: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    begun_s: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    errors: list[str] = field(default_factory=list)
    error_count: int = 0
    sent_bytes: int = 0
    scored: int = 0

    def err(self, words: str) -> None:
        self.error_count += 1
        if len(self.errors) < MOST_ERRORS:
            self.errors.append(words)


@dataclass(frozen=True)
class LoadReply:
    status: int
    headers: Mapping[str, str]
    body: bytes

    def json(self) -> Any:
        return json.loads(self.body)


class UnexpectedError(Exception):
    """An answer differs from the expected one."""


class Client:
    """One connection as one user."""

    def __init__(self, plan: LoadPlan, secret: str, noted: LoadLog, team: str = "") -> None:
        self.plan, self.noted, self.team, self.tags = plan, noted, team, dict[str, str]()
        self._secret = secret
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def ask(self, what: str, method: str, path: str, expected: tuple[int, ...], **request: Any) -> LoadReply:
        """Send a request, log it and return the answer. Raises `UnexpectedError`."""
        begun_s = time.perf_counter()
        try:
            answer = await self._sent(method, path, request.get("headers", {}), request.get("body", b""))
        except (OSError, asyncio.IncompleteReadError) as error:
            await self.close()
            raise UnexpectedError(f"{what}: {type(error).__name__}: {error}") from error
        self.noted.waited_s[what].append(time.perf_counter() - begun_s)
        self.noted.begun_s[what].append(begun_s)
        if answer.status not in expected:
            raise UnexpectedError(f"{what}: {answer.status} {answer.body[:300]!r}")
        return answer

    async def close(self) -> None:
        """Close the connection; the next request opens another."""
        streams, self._streams = self._streams, None
        if streams is not None:
            streams[1].close()
            with suppress(OSError):
                await streams[1].wait_closed()

    async def _sent(self, method: str, path: str, headers: Mapping[str, str], body: bytes) -> LoadReply:
        if self._streams is None:
            source = (self.plan.source, 0)
            self._streams = await asyncio.open_connection("127.0.0.1", self.plan.port, local_addr=source)
        incoming, outgoing = self._streams
        lines = {"Host": "api", "Authorization": f"Bearer {self._secret}", "Content-Length": str(len(body)), **headers}
        head = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
        outgoing.write(f"{method} {PREFIX}{path} HTTP/1.1\r\n{head}\r\n".encode() + body)
        await outgoing.drain()
        status, *rest = (await incoming.readuntil(b"\r\n\r\n")).decode("latin-1").split("\r\n")
        fields = {name.lower(): value.strip() for name, _, value in (line.partition(":") for line in rest if line)}
        size = int(fields.get("content-length", 0))
        content = await incoming.readexactly(size) if size and method != "HEAD" else b""
        return LoadReply(int(status.split()[1]), fields, content)


async def read(client: Client, chance: random.Random) -> None:
    """Request one of the lists; a repeated request sends the tag of the first."""
    (what, path, _), *_ = chance.choices(READS, [share for *_, share in READS])
    await read_path(client, what, path)


async def read_path(client: Client, what: str, path: str) -> None:
    """Request one path, with its last tag if it was requested before."""
    named = path.format(sequence=client.plan.sequence, benchmark=client.plan.benchmark, phase=client.plan.phase)
    headers = {"If-None-Match": client.tags[named]} if "again" in what and named in client.tags else {}
    answer = await client.ask(what, "GET", named, (200, 304), headers=headers)
    if "etag" in answer.headers:
        client.tags[named] = answer.headers["etag"]


async def upload(client: Client, chance: random.Random) -> None:
    """Upload a file of several pieces and delete it when it is complete, so that the disk is not measured."""
    content = chance.randbytes(PIECE_BYTES)
    size = PIECES * PIECE_BYTES
    path, _ = await _announce(client, size, {"filename": "load.mcap", "purpose": "recording"})
    for number in range(PIECES):
        offset = {**BYTES, "Upload-Offset": str(number * PIECE_BYTES)}
        await client.ask("upload: PATCH of 1 MiB", "PATCH", path, (204,), headers=offset, body=content)
    client.noted.sent_bytes += size
    await client.ask("upload: DELETE", "DELETE", path, (204,), headers=TUS)


async def submit(client: Client, chance: random.Random) -> None:
    """Take a submission from its draft to its score."""
    submission_id = await send_submission(client, chance)
    begun_s = time.perf_counter()
    while True:
        await asyncio.sleep(POLL_S)
        submission = (await client.ask("submit: look", "GET", f"/submissions/{submission_id}", (200,))).json()
        if submission["state"] == "scored":
            client.noted.scored += 1
            client.noted.waited_s["submit: until scored"].append(time.perf_counter() - begun_s)
            client.noted.begun_s["submit: until scored"].append(begun_s)
            return
        if submission["state"] not in ("queued", "scoring"):
            raise UnexpectedError(f"submission ended {submission['state']}: {submission}")


async def send_submission(client: Client, chance: random.Random) -> str:
    """Take a submission from its draft to its queued checks; return its id."""
    content = Path(client.plan.zip_path).read_bytes()
    digest = sha256(content).hexdigest()
    draft = {"team_id": client.team, "method": f"load {chance.random()}", "modality": "L", "sha256": digest}
    made = await _post(client, "submit: draft", f"/phases/{client.plan.phase_id}/submissions", draft | _size(content))
    metadata = {"filename": "guess.zip", "purpose": "submission", "target_id": made["id"], "sha256": digest}
    path, here_bytes = await _announce(client, len(content), metadata, "submit: announce")
    if here_bytes < len(content):  # existing bytes are not sent again
        patch, rest = {**BYTES, "Upload-Offset": str(here_bytes)}, content[here_bytes:]
        await client.ask("submit: PATCH of the file", "PATCH", path, (204, 200), headers=patch, body=rest)
    await _post(client, "submit: finalize", f"/submissions/{made['id']}/finalize", {"upload_id": path.split("/")[-1]})
    return str(made["id"])


def _size(content: bytes) -> dict[str, int]:
    return {"size_bytes": len(content)}


async def _announce(
    client: Client, size: int, fields: Mapping[str, str], what: str = "upload: announce"
) -> tuple[str, int]:
    """Return the upload's path, and the number of its bytes on the server."""
    metadata = ",".join(f"{key} {base64.b64encode(value.encode()).decode()}" for key, value in fields.items())
    headers = {**TUS, "Upload-Length": str(size), "Upload-Metadata": metadata}
    answer = await client.ask(what, "POST", "/uploads", (201,), headers=headers)
    return "/uploads/" + answer.headers["location"].rpartition("/")[2], int(answer.headers["upload-offset"])


async def _post(client: Client, what: str, path: str, body: Mapping[str, Any]) -> Any:
    text = json.dumps(body).encode()
    answer = await client.ask(
        what, "POST", path, (200, 201, 202), headers={"Content-Type": "application/json"}, body=text
    )
    return answer.json()


async def live(client: Client, act: Callable[[Client, random.Random], Awaitable[None]], seed: int) -> None:
    """Act and pause until the time is over."""
    chance, noted, plan = random.Random(seed), client.noted, client.plan
    until_s = time.perf_counter() + plan.seconds
    await asyncio.sleep(chance.random() * plan.pause_s)
    while time.perf_counter() < until_s:
        try:
            await act(client, chance)
        except UnexpectedError as error:
            noted.err(str(error))
        await asyncio.sleep(chance.uniform(0.5, 1.5) * plan.pause_s)
    await client.close()


async def all_live(plan: LoadPlan) -> LoadLog:
    noted, lives = LoadLog(), []
    acts = [read] * plan.readers + [upload] * plan.uploaders
    for number, act in enumerate(acts):
        lives.append(live(Client(plan, plan.secrets[number % len(plan.secrets)], noted), act, number))
    for number in range(plan.submitters):
        team, secret = plan.captains[number % len(plan.captains)]
        lives.append(live(Client(plan, secret, noted, team), submit, -number))
    await asyncio.gather(*lives)
    return noted


def main() -> None:
    plan_path, out_path = map(Path, sys.argv[1:])
    record = json.loads(plan_path.read_text())
    plan = LoadPlan(
        **{**record, "captains": tuple(map(tuple, record["captains"])), "secrets": tuple(record["secrets"])}
    )
    out_path.write_text(json.dumps(vars(asyncio.run(all_live(plan)))))


if __name__ == "__main__":
    main()
