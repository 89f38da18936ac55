"""The platform's REST API for programs: requests with safe retries, refusals as errors.

**Conventions.** GET, HEAD, PUT, DELETE and a POST with an Idempotency-Key are sent again after a broken connection,
429, 502, 503 and 504; the pause follows `Retry-After`. Any request is sent again if its connection was never
established. Requests to a server on this machine bypass proxies.
"""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import TracebackType
from typing import Any
from uuid import uuid4

import httpx

from stone_base.errors import Refused
from stone_base.releases import HEADER, is_older
from stone_client.credentials import Server, is_local
from stone_client.errors import ServerFaultError, ServerRefusedError, ServerUnreachableError
from stone_client.release import OLDEST_SERVER, own_release

PREFIX = "/api/v1"
REPLY_S = 60.0
CONNECT_S = 10.0
SAFE = frozenset({"GET", "HEAD", "PUT", "DELETE", "OPTIONS"})
BUSY = frozenset({429, 502, 503, 504})
FIRST_PAUSE_S = 0.25
LONGEST_PAUSE_S = 15.0
PAGE_ITEMS = 200


class Api:
    """The REST API of one server: `with Api(server) as api: api.read("/sequences")`. Every answer other than success
    raises.
    """

    def __init__(self, server: Server, patience_s: float = 60.0, transport: httpx.BaseTransport | None = None) -> None:
        self.url = server.url
        self._patience_s = patience_s
        headers = {"User-Agent": f"stone-client/{own_release()}", HEADER: own_release()}
        if server.token:
            headers["Authorization"] = f"Bearer {server.token}"
        self._http = httpx.Client(
            base_url=server.url,
            headers=headers,
            timeout=httpx.Timeout(REPLY_S, connect=CONNECT_S),
            trust_env=not is_local(server.url),
            transport=transport,
        )

    def __enter__(self) -> "Api":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._http.close()

    def read(self, path: str, **query: str | int) -> dict[str, Any]:
        """Return the JSON object at `path`."""
        answer: dict[str, Any] = self.send("GET", path, params=query).json()
        return answer

    def create(self, path: str, body: Mapping[str, Any], revision: int | None = None) -> dict[str, Any]:
        """POST a body and return the answer; a retry after a broken connection creates nothing twice.

        With `revision` the server refuses the request (`precondition_failed`) if the state has changed since that
        revision.
        """
        match = {} if revision is None else {"If-Match": f'"{revision}"'}
        headers = {"Idempotency-Key": uuid4().hex, **match}
        answer: dict[str, Any] = self.send("POST", path, json=body, headers=headers).json()
        return answer

    def pages(self, path: str, **query: str | int) -> Iterator[Any]:
        """Yield every item of a list, page by page."""
        cursor = ""
        while True:
            page = self.read(path, limit=PAGE_ITEMS, **query, **({"cursor": cursor} if cursor else {}))
            yield from page["items"]
            cursor = page["next"]
            if not cursor:
                return

    def send(self, method: str, path: str, **request: Any) -> httpx.Response:
        """Send a request, with retries, and return the answer. `path` is below `/api/v1`, or a whole URL of this
        server.

        Raises `ServerRefusedError`, `ServerFaultError`, `ServerUnreachableError`, `server_too_old`.
        """
        is_repeatable = method in SAFE or "Idempotency-Key" in request.get("headers", {})
        patience = Patience(self._patience_s)
        while True:
            try:
                answer = self._http.request(method, self._path(path), **request)
            except httpx.TransportError as error:
                self._wait_after(error, patience, is_repeatable)
                continue
            self._check_release(answer)
            if answer.is_success:
                return answer
            if not (is_repeatable and _is_busy(answer) and patience.wait(_retry_after_s(answer))):
                raise refusal(answer)

    @contextmanager
    def stream(
        self, path: str, headers: Mapping[str, str] | None = None, read_s: float = REPLY_S
    ) -> Iterator[httpx.Response]:
        """Yield the answer of a GET whose body is read as it arrives; it is not sent again. Raises as `send`, and
        httpx's errors.
        """
        timeout = httpx.Timeout(read_s, connect=CONNECT_S)
        with self._http.stream("GET", self._path(path), headers=dict(headers or {}), timeout=timeout) as answer:
            self._check_release(answer)
            if not answer.is_success:
                answer.read()
                raise refusal(answer)
            yield answer

    def _path(self, path: str) -> str:
        """Return the path on this server: the token must never be sent to another server."""
        if "://" in path:
            path = httpx.URL(path).raw_path.decode("ascii")
        return path if path.startswith(PREFIX) else PREFIX + path

    def _check_release(self, answer: httpx.Response) -> None:
        """Raise `server_too_old` for an unsupported release; a server without the header is accepted."""
        release = answer.headers.get(HEADER, "")
        if is_older(release, OLDEST_SERVER):
            raise Refused(
                "server_too_old",
                f"{self.url} runs release {release[:40]}, but this client requires {OLDEST_SERVER} or newer; ask its "
                f"administrator to update it, or install its own client from {self.url}/downloads/",
            )

    def _wait_after(self, error: httpx.TransportError, patience: "Patience", is_repeatable: bool) -> None:
        was_sent = not isinstance(error, httpx.ConnectError | httpx.ConnectTimeout)
        if (was_sent and not is_repeatable) or not patience.wait(None):
            raise ServerUnreachableError(self.url, str(error) or type(error).__name__) from None


class Patience:
    """The time limit for retries: pauses double, within `limit_s` of the first."""

    def __init__(self, limit_s: float) -> None:
        self._until_s = time.monotonic() + limit_s
        self._pause_s = FIRST_PAUSE_S

    def wait(self, asked_s: float | None) -> bool:
        """Pause for `asked_s`, or longer than the last pause. Return False at once if the limit would be exceeded."""
        pause_s = self._pause_s if asked_s is None else asked_s
        if time.monotonic() + pause_s > self._until_s:
            return False
        time.sleep(pause_s)
        self._pause_s = min(2 * self._pause_s, LONGEST_PAUSE_S)
        return True


def refusal(answer: httpx.Response) -> ServerRefusedError | ServerFaultError:
    """Return the refusal in the answer as an error."""
    try:
        problem = answer.json()
    except ValueError:
        problem = None
    if isinstance(problem, dict) and "code" in problem:
        return ServerRefusedError(answer.status_code, problem, _retry_after_s(answer))
    return ServerFaultError(answer.status_code, str(answer.request.url), answer.text)


def _is_busy(answer: httpx.Response) -> bool:
    """Return whether the server may accept the same request later."""
    return answer.status_code in BUSY or (answer.status_code == 409 and "Retry-After" in answer.headers)


def _retry_after_s(answer: httpx.Response) -> float | None:
    """Return the seconds of `Retry-After`; None if the header is absent or a date."""
    header = answer.headers.get("Retry-After", "")
    return float(header) if header.isdecimal() else None
