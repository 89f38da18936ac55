"""A provider's description and keys, read from the issuer's address and cached for a while.

**Conventions.** `issuer` in the description must equal the setting character by character (Discovery 1.0, section 4.3).
Addresses are https, or on this machine if the issuer is. Keys are read again after `KEPT_S`, and if a token names an
unknown key, because a provider may change its keys at any time. This happens at most once per `REREAD_S`, so false
tokens cannot cause endless requests.
"""

import asyncio
import json
import ssl
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from threading import Lock
from typing import Any
from urllib.parse import urlsplit

import httpx
from joserfc.errors import JoseError
from joserfc.jwk import KeySet

from services.runtime.oidc.errors import provider_answer, provider_unavailable
from services.runtime.oidc.settings import OidcSettings, is_local

# Requests to a provider, bounded in size and time for any answer: JSON objects only.
#
# **Conventions.** `timeout_s` limits the whole exchange, from the name lookup to the last byte, so a slow provider
# cannot delay it further. Redirects are not followed: another host's answer is not the provider's. Compressed answers
# are refused, since their size is not known in advance.


LONGEST_BYTES = 256 * 2**10
HEADERS = {"Accept": "application/json", "Accept-Encoding": "identity", "User-Agent": "stone-platform"}
Json = dict[str, Any]


def read_json(url: str, what: str, timeout_s: float) -> Json:
    """Return the object at `url`; `what` names it in errors. Raises `provider_unavailable`, `provider_answer`."""
    status, content = _answer(httpx.Request("GET", url, headers=HEADERS), timeout_s)
    if status != 200:
        raise provider_answer(what, f"returned status {status}")
    return _object(content, what)


def send_form(url: str, form: Mapping[str, str], headers: Mapping[str, str], timeout_s: float) -> tuple[int, Json]:
    """Send a form; return the status and object of the answer. Raises as `read_json` does."""
    request = httpx.Request("POST", url, data=dict(form), headers={**HEADERS, **headers})
    status, content = _answer(request, timeout_s)
    return status, _object(content, "token endpoint")


def _answer(request: httpx.Request, timeout_s: float) -> tuple[int, bytes]:
    host = request.url.host
    try:
        with ThreadPoolExecutor(1) as apart:  # the caller's own thread may run an event loop
            return apart.submit(_run, request, timeout_s).result()
    except TimeoutError:
        raise provider_unavailable(host, f"it did not respond within {timeout_s:g} s") from None
    except (httpx.HTTPError, httpx.InvalidURL, OSError, UnicodeError) as error:
        raise provider_unavailable(host, f"{type(error).__name__}: {error}") from None


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
        raise provider_answer("answer", "is compressed, although the request excluded it")
    content = bytearray()
    async for piece in answer.aiter_raw():
        content += piece
        if len(content) > LONGEST_BYTES:
            raise provider_answer("answer", f"is longer than {LONGEST_BYTES} bytes")
    return bytes(content)


def _object(content: bytes, what: str) -> Json:
    try:
        value = json.loads(content)
    except (ValueError, RecursionError):
        raise provider_answer(what, "is no JSON") from None
    if not isinstance(value, dict):
        raise provider_answer(what, "is no JSON object")
    return value


@cache
def _certificates() -> ssl.SSLContext:
    """Return the machine's certificate authorities, cached because reading them takes longer than the request."""
    return ssl.create_default_context()


WELL_KNOWN = "/.well-known/openid-configuration"
DESCRIPTION = "description"
KEPT_S = 600.0
REREAD_S = 30.0
MOST_KEYS = 64


@dataclass(frozen=True)
class ProviderMetadata:
    """A provider's addresses; `takes_secret_in_body`: its token endpoint does not support HTTP Basic."""

    authorization_url: str
    token_url: str
    keys_url: str
    takes_secret_in_body: bool


class KeptMetadata:
    """Description and keys of the provider of these settings, shared by the threads of a process."""

    def __init__(self, settings: OidcSettings, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._settings, self._now_s, self._lock = settings, monotonic_s, Lock()
        self._described: tuple[float, ProviderMetadata] | None = None
        self._keys: tuple[float, KeySet] | None = None

    def metadata(self) -> ProviderMetadata:
        """Return the description. Raises `provider_unavailable`, `provider_answer`."""
        with self._lock:
            known = self._described
        if known is None or self._now_s() - known[0] > KEPT_S:
            known = self._now_s(), read_metadata(self._settings)
            with self._lock:
                self._described = known
        return known[1]

    def keys(self, wanted_id: str | None) -> KeySet:
        """Return its keys, read again if none has the id `wanted_id`. Raises as `metadata` does."""
        with self._lock:
            known = self._keys
        if known is None or self._is_due(known, wanted_id):
            known = self._now_s(), read_keys(self.metadata().keys_url, self._settings.timeout_s)
            with self._lock:
                self._keys = known
        return known[1]

    def _is_due(self, known: tuple[float, KeySet], wanted_id: str | None) -> bool:
        age_s = self._now_s() - known[0]
        is_there = wanted_id is None or any(key.kid == wanted_id for key in known[1])
        return age_s > (KEPT_S if is_there else REREAD_S)


def read_metadata(settings: OidcSettings) -> ProviderMetadata:
    """Read the description from the issuer. Raises `provider_unavailable`, `provider_answer`."""
    described = read_json(settings.issuer.rstrip("/") + WELL_KNOWN, DESCRIPTION, settings.timeout_s)
    if described.get("issuer") != settings.issuer:
        raise provider_answer(
            DESCRIPTION, f"names the issuer {str(described.get('issuer'))[:100]!r}, not {settings.issuer!r}"
        )
    methods = described.get("token_endpoint_auth_methods_supported", ["client_secret_basic"])
    return ProviderMetadata(
        _address(settings, described, "authorization_endpoint"),
        _address(settings, described, "token_endpoint"),
        _address(settings, described, "jwks_uri"),
        takes_secret_in_body=isinstance(methods, list) and "client_secret_basic" not in methods,
    )


def read_keys(url: str, timeout_s: float) -> KeySet:
    """Return the keys at this address. Raises `provider_unavailable`, `provider_answer`."""
    listed = read_json(url, "key set", timeout_s).get("keys")
    if not isinstance(listed, list) or not 0 < len(listed) <= MOST_KEYS:
        raise provider_answer("key set", f"must list 1 to {MOST_KEYS} keys")
    try:
        return KeySet.import_key_set({"keys": [key for key in listed if _is_for_signing(key)]})
    except (JoseError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise provider_answer("key set", f"cannot be read: {type(error).__name__}") from None


def _is_for_signing(key: Any) -> bool:
    """Return whether a key may verify signatures: neither a published secret key nor an encryption key may."""
    return isinstance(key, dict) and key.get("kty") != "oct" and key.get("use", "sig") == "sig"


def _address(settings: OidcSettings, described: Json, name: str) -> str:
    address = described.get(name)
    try:
        parts = urlsplit(address) if isinstance(address, str) and address.isprintable() else None
    except ValueError:
        parts = None
    if parts is None or not parts.hostname or parts.username or parts.fragment:
        raise provider_answer(DESCRIPTION, f"has no address at {name!r}")
    is_near = parts.scheme == "http" and is_local(parts) and settings.issuer.startswith("http://")
    if parts.scheme != "https" and not is_near:
        raise provider_answer(DESCRIPTION, f"has an address without https at {name!r}")
    return str(address)
