"""Requests to a provider, bounded in size and time whatever it answers: JSON objects only.

**Conventions.** `timeout_s` is for the whole exchange, from the name's look-up to the last byte: a provider that
answers a byte at a time holds nobody longer. Redirects are not followed: another host's answer is not the provider's.
Compressed answers are refused, since their size is not known before.
"""

import asyncio
import json
import ssl
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any
from urllib.parse import urlsplit

import httpx

from services.runtime.oidc.errors import ProviderAnswerError, ProviderAwayError
from services.runtime.oidc.settings_checks import is_local

LONGEST_BYTES = 256 * 2**10
HEADERS = {"Accept": "application/json", "Accept-Encoding": "identity", "User-Agent": "stone-platform"}
Json = dict[str, Any]


def read_json(url: str, what: str, timeout_s: float) -> Json:
    """The object at `url`, which `what` names in a refusal. Raises `ProviderAwayError`, `ProviderAnswerError`."""
    status, content = _answer(httpx.Request("GET", url, headers=HEADERS), timeout_s)
    if status != 200:
        raise ProviderAnswerError(what, f"is answered with status {status}")
    return _object(content, what)


def send_form(url: str, form: Mapping[str, str], headers: Mapping[str, str], timeout_s: float) -> tuple[int, Json]:
    """The status and object of the answer to a form. Raises as `read_json` does."""
    request = httpx.Request("POST", url, data=dict(form), headers={**HEADERS, **headers})
    status, content = _answer(request, timeout_s)
    return status, _object(content, "token endpoint")


def _answer(request: httpx.Request, timeout_s: float) -> tuple[int, bytes]:
    host = request.url.host
    try:
        with ThreadPoolExecutor(1) as apart:  # the caller's own thread may stand within an event loop
            return apart.submit(_run, request, timeout_s).result()
    except TimeoutError:
        raise ProviderAwayError(host, f"it did not answer within {timeout_s:g} s") from None
    except (httpx.HTTPError, httpx.InvalidURL, OSError, UnicodeError) as error:
        raise ProviderAwayError(host, f"{type(error).__name__}: {error}") from None


def _run(request: httpx.Request, timeout_s: float) -> tuple[int, bytes]:
    return asyncio.run(_exchange(request, timeout_s))


async def _exchange(request: httpx.Request, timeout_s: float) -> tuple[int, bytes]:
    is_near = is_local(urlsplit(str(request.url)))
    client = httpx.AsyncClient(verify=_certificates(), timeout=timeout_s, trust_env=not is_near)
    async with asyncio.timeout(timeout_s), client:
        answer = await client.send(request, stream=True, follow_redirects=False)
        try:
            return answer.status_code, await _content(answer)
        finally:
            await answer.aclose()


async def _content(answer: httpx.Response) -> bytes:
    if answer.headers.get("content-encoding", "identity") != "identity":
        raise ProviderAnswerError("answer", "is compressed, which was not asked for")
    content = bytearray()
    async for piece in answer.aiter_raw():
        content += piece
        if len(content) > LONGEST_BYTES:
            raise ProviderAnswerError("answer", f"is longer than {LONGEST_BYTES} bytes")
    return bytes(content)


def _object(content: bytes, what: str) -> Json:
    try:
        value = json.loads(content)
    except (ValueError, RecursionError):
        raise ProviderAnswerError(what, "is no JSON") from None
    if not isinstance(value, dict):
        raise ProviderAnswerError(what, "is no JSON object")
    return value


@cache
def _certificates() -> ssl.SSLContext:
    """The machine's certificate authorities, read once: it takes longer than the request."""
    return ssl.create_default_context()
