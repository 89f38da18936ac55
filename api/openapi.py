"""The OpenAPI document: FastAPI's, completed with the common parts of all routes.

**Conventions.** Each operation lists every status that it can return: the route names the particular ones
(`refusals(…)`), and this module adds those that follow from its form. `security` names the scheme, the required scope
and the roles.
"""

import json
import re
from collections.abc import Callable, Iterator
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from fastapi.routing import APIRoute
from pydantic.json_schema import models_json_schema

from api.answers import refusal
from api.problems import Problem, ProblemFinding
from api.words import describe

PREFIX = "/api/v1"
METHODS = ("get", "put", "post", "delete", "patch", "options", "head")
ALWAYS = (422, 429, 500, 503)
TO_CALLERS = (401, 403)
OF_BODIES = (400, 408, 413, 415)
OF_KEYS = (409,)
OF_WRITING = (507,)
KEY = {
    "name": "Idempotency-Key",
    "in": "header",
    "required": False,
    "description": "A repetition within 24 hours has no further effect and returns the first response.",
    "schema": {"type": "string", "pattern": "^[!-~]{1,128}$"},
    "example": "5f3a9c1e-first-try",
}
MATCH = {
    "name": "If-Match",
    "in": "header",
    "required": False,
    "description": "ETag from the last read of the resource.",
    "schema": {"type": "string"},
    "example": '"3"',
}

Operation = dict[str, Any]
CLAUSE_END = re.compile(r"[;:.]\s")


def documented(api: FastAPI) -> Callable[[], dict[str, Any]]:
    """Return a function that makes the document of `api`, once."""

    def document() -> dict[str, Any]:
        if api.openapi_schema is None:
            api.openapi_schema = _document(api)
        return api.openapi_schema

    return document


def operation_id(route: APIRoute) -> str:
    """Return the name of the route: a verb and a noun, unique in the document."""
    return route.name


def operations(document: dict[str, Any]) -> Iterator[tuple[str, str, Operation]]:
    """Yield (path, method, operation) of every operation in the document."""
    for path, methods in document["paths"].items():
        yield from ((path, method, methods[method]) for method in METHODS if method in methods)


def _document(api: FastAPI) -> dict[str, Any]:
    servers = [{"url": "/", "description": "This server."}]
    document = get_openapi(
        title=api.title, version=api.version, description=api.description, routes=api.routes, servers=servers
    )
    schemas = document.setdefault("components", {}).setdefault("schemas", {})
    schemas |= _problem_schemas()
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    for path, method, operation in operations(document):
        _complete(path, method, operation)
        _give_examples(operation, schemas)
    describe(document)
    return document


def _give_examples(operation: Operation, schemas: dict[str, Any]) -> None:
    """Add the examples of its schema to each body."""
    for content in operation.get("requestBody", {}).get("content", {}).values():
        examples = schemas.get(content["schema"].get("$ref", "").rpartition("/")[2], {}).get("examples", ())
        if examples:
            content["example"] = examples[0]


def _problem_schemas() -> dict[str, Any]:
    """Return the schemas of a problem and of its findings; the latter is named `Finding` for clients."""
    _, schemas = models_json_schema(
        [(model, "serialization") for model in (Problem, ProblemFinding)], ref_template="#/components/schemas/{model}"
    )
    published: dict[str, Any] = json.loads(json.dumps(schemas["$defs"]).replace("ProblemFinding", "Finding"))
    return dict(sorted(published.items()))


def _complete(path: str, method: str, operation: Operation) -> None:
    """Add the parts that follow from the operation's form."""
    operation["summary"] = _summary(operation)
    answers = operation["responses"]
    if "HTTPValidationError" in str(answers.get("422", "")):
        del answers["422"]
    for status in sorted(_implied(path, method, operation)):
        answers.setdefault(str(status), refusal(status))
    operation["responses"] = {status: answers[status] for status in sorted(answers)}
    if _takes_key(path, method, operation):
        operation.setdefault("parameters", []).append(KEY)
    if "428" in answers or (method == "put" and "412" in answers):
        operation.setdefault("parameters", []).append(MATCH)


def _summary(operation: Operation) -> str:
    """Return the route's own summary, or the start of its description instead of the function's name."""
    given: str = operation["summary"]
    is_made_of_a_name = operation["operationId"] == given.replace(" ", "_").lower()
    if not is_made_of_a_name or "description" not in operation:
        return given
    return CLAUSE_END.split(operation["description"], maxsplit=1)[0].removesuffix(".").replace("\n", " ")


def _implied(path: str, method: str, operation: Operation) -> set[int]:
    if not path.startswith(PREFIX):
        return {500}
    implied = {*ALWAYS}
    implied |= {*TO_CALLERS} if "security" in operation else set()
    implied |= {*OF_BODIES} if "requestBody" in operation else set()
    implied |= {*OF_KEYS} if _takes_key(path, method, operation) else set()
    return implied | ({*OF_WRITING} if method in ("post", "put", "patch") else set())


def _takes_key(path: str, method: str, operation: Operation) -> bool:
    return method == "post" and path.startswith(PREFIX) and "security" in operation
