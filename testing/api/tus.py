"""Plain HTTP for the tests of uploads: creations, pieces, offsets."""

import base64
import hashlib
from typing import Any

import httpx

from testing.api.serving import Person

TUS = {"Tus-Resumable": "1.0.0"}
PIECE = {**TUS, "Content-Type": "application/offset+octet-stream"}
UPLOADS = "/api/v1/uploads"
CONTENT = bytes(range(256)) * 40
FORM = {"purpose": "recording"}


def metadata(**values: str) -> str:
    return ",".join(f"{key} {base64.b64encode(value.encode()).decode()}" for key, value in values.items())


def checksum(content: bytes, algorithm: str = "sha1") -> str:
    return f"{algorithm} {base64.b64encode(hashlib.new(algorithm, content).digest()).decode()}"


def sha256_of(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def create(api: httpx.Client, owner: Person, length: int, **fields: str) -> httpx.Response:
    named = {"filename": "run.mcap", "purpose": "recording", **fields}
    headers = {**TUS, **owner.headers, "Upload-Length": str(length), "Upload-Metadata": metadata(**named)}
    return api.post(UPLOADS, headers=headers)


def created(api: httpx.Client, owner: Person, length: int, **fields: str) -> str:
    """Create an upload and return its path."""
    reply = create(api, owner, length, **fields)
    assert reply.status_code == 201, reply.text
    return str(reply.headers["Location"])


def patch(api: httpx.Client, owner: Person, where: str, offset: int, content: Any, **headers: str) -> httpx.Response:
    extra = {name.replace("_", "-"): value for name, value in headers.items()}
    return api.patch(where, content=content, headers={**PIECE, **owner.headers, "Upload-Offset": str(offset), **extra})


def ask(api: httpx.Client, owner: Person, where: str) -> httpx.Response:
    return api.head(where, headers={**TUS, **owner.headers})


def offset_of(api: httpx.Client, owner: Person, where: str) -> int:
    reply = ask(api, owner, where)
    assert reply.status_code == 200, reply.status_code
    return int(reply.headers["Upload-Offset"])


def shown(api: httpx.Client, owner: Person, where: str) -> dict[str, Any]:
    reply = api.get(where, headers=owner.headers)
    assert reply.status_code == 200, reply.text
    body: dict[str, Any] = reply.json()
    return body


def send_form(api: httpx.Client, owner: Person, content: bytes, **fields: str) -> httpx.Response:
    return api.post(
        f"{UPLOADS}/form", data={**FORM, **fields}, files={"file": ("a.mcap", content)}, headers=owner.headers
    )


def code_of(reply: httpx.Response) -> tuple[int, str]:
    assert reply.headers["content-type"] == "application/problem+json"
    assert reply.headers["Tus-Resumable"] == "1.0.0"
    return reply.status_code, reply.json()["code"]
