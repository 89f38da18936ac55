"""The machinery: asks every operation as every caller and tells what is not as the table says.

**Conventions.** A finding is one sentence. Nothing here knows a route; the application may be any that has an OpenAPI
document and a table.
"""

import re
from collections.abc import Iterator, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from typing import Any

import httpx
from fastapi import FastAPI
from fastapi.routing import iter_route_contexts

from api.openapi import operations
from tests.api.access.asking import Asked, asked
from tests.api.access.cast import OF_OWNER, Cast
from tests.api.access.table import Operation
from tests.api.access.world import UNKNOWN, WORDS, World

Table = Mapping[Operation, Mapping[str, int]]
CONVERTER = re.compile(r":\w+(?=})")  # of a parameter that takes slashes
OF_A_MOMENT = {"x-request-id", "date", "content-length"}
SEEING_ALL = (*OF_OWNER, "administrator")


@dataclass(frozen=True)
class Answer:
    """What came back; of a stream its first event."""

    status: int
    text: str
    headers: Mapping[str, str]


@dataclass(frozen=True)
class Matrix:
    """An application under test, its table, and whose things are asked for."""

    client: httpx.Client
    document: Mapping[str, Any]
    table: Table

    def findings(self, caller: str, cast: Cast, world: World, only: Operation | None = None) -> Iterator[str]:
        """What is wrong with the cells of `caller` in this world."""
        for operation in [only] if only else operations_in(self.document):
            yield from self._cell(caller, cast, world, operation)

    def _cell(self, caller: str, cast: Cast, world: World, operation: Operation) -> Iterator[str]:
        name = f"{caller}: {' '.join(operation)}"
        expected = self.table[operation][caller]
        request = asked(self.document, operation, world.named, self._name(cast, caller))
        answer = self.send(request, cast.shown(caller, request.scope))
        if answer.status != expected:
            yield f"{name}: {answer.status}, not {expected}: {answer.text[:200]}"
        yield from (f"{name}: tells {shown}" for shown in told(answer, caller, request, world))
        if answer.status == 404 and caller not in SEEING_ALL:
            yield from self._difference(name, answer, (caller, cast, world), request)

    def _difference(self, name: str, answer: Answer, asking: tuple[str, Cast, World], request: Asked) -> Iterator[str]:
        """How the answer differs from that for something that does not exist at all, in a benchmark that does."""
        caller, cast, world = asking
        unknown_things = {**WORDS, **UNKNOWN, "benchmark_name": world.named["benchmark_name"]}
        nothing = asked(self.document, request.operation, unknown_things, self._name(cast, caller))
        unknown = self.send(nothing, cast.shown(caller, request.scope))
        theirs, none = neutral(answer, request.ids), neutral(unknown, nothing.ids)
        if theirs != none:
            yield f"{name}: what is not theirs is {theirs}, what does not exist {none}"

    def send(self, request: Asked, credential: Mapping[str, str]) -> Answer:
        """Ask once; of a stream only the first event is waited for."""
        content = dict(request.content)
        headers = {**request.headers, **content.pop("headers", {}), **credential}
        method = request.operation[0]
        with self.client.stream(method, request.path, headers=headers, **content) as response:
            is_stream = response.headers.get("content-type", "").startswith("text/event-stream")
            pieces = response.iter_text()
            text = next(pieces) if is_stream else "".join(pieces)
            return Answer(response.status_code, text, dict(response.headers))

    @staticmethod
    def _name(cast: Cast, caller: str) -> str:
        return cast.users[caller].name if caller in cast.users else "nobody"


def operations_in(document: Mapping[str, Any]) -> list[Operation]:
    return [(method.upper(), path) for path, method, _ in operations(dict(document))]


def told(answer: Answer, caller: str, request: Asked, world: World) -> list[str]:
    """What of the owner's the answer shows to somebody else, beyond what they named themselves."""
    if caller in SEEING_ALL:
        return []
    return sorted(one for one in world.ids - request.ids if one in answer.text or one in str(answer.headers))


def neutral(answer: Answer, ids: AbstractSet[str]) -> tuple[int, str, dict[str, str]]:
    """The answer without the ids that were asked for and without what is of the moment."""
    text = re.sub(r'"request_id":"[^"]*"', "", answer.text)
    for one in sorted(ids):
        text = text.replace(one, "ID")
    return answer.status, text, {name: value for name, value in answer.headers.items() if name not in OF_A_MOMENT}


def unlisted(application: FastAPI, table: Table) -> set[Operation]:
    """Routes that are served but not in the table, or in the table but not served; the document itself aside."""
    routes = [route for route in iter_route_contexts(application.routes) if route.path != application.openapi_url]
    served = {(method, CONVERTER.sub("", route.path or "")) for route in routes for method in route.methods or ("ANY",)}
    return (served | set(operations_in(application.openapi()))) ^ set(table)


def make_matrix(client: httpx.Client, application: FastAPI, table: Table) -> Matrix:
    return Matrix(client, application.openapi(), table)
