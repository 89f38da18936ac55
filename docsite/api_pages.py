"""The API reference, from the server's OpenAPI document: a page for each noun, one for bodies.

**Conventions.** An operation's anchor is its id; a body's anchor is its name in lower case, on the page `bodies`.
Nothing is added to the document's content.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from api.main import make_api
from api.openapi import Operation, operations
from docsite.markdown import code, plain, table
from docsite.schemas import body_link, body_section, type_of
from services.runtime.platform import open_platform
from services.runtime.settings import Settings

FOLDER = "reference/api"
FIRST_REFUSAL = 400
ANYBODY: tuple[dict[str, list[str]], ...] = ({"": ["everyone"]},)
INDEX = """# API

Version 1 is below `/api/v1`. Each server provides its OpenAPI document at `/api/v1/openapi.json` and a page of it at
`/api/v1/docs`; these pages are generated from the same document.

- **Authentication.** Send `Authorization: Bearer stone_…` with a token of [`POST /tokens`](people.md), or a browser
  session with `X-CSRF-Token` on unsafe methods. Each operation lists its required scope and roles.
- **Refusals** are `application/problem+json` (RFC 9457) with a stable [code](../codes.md). Objects that you may not see
  return 404.
- **Unknown** query parameters and unknown keys of a body are refused (422); the finding lists the known names.
- **Lists** are `{"items": […], "next": …}`, paged by `cursor` and `limit`; short lists have a single page. Paging never
  skips or repeats an item that existed at the first page.
- **Retries.** POST requests that create objects accept an `Idempotency-Key`; the same request within a day returns the
  same answer.
- **Changes.** Objects that can change have an `ETag`. Changing one requires `If-Match`, and returns 412 if the object
  has changed in the meantime.
- **Clients** can be generated from the document: for Python with `openapi-python-client` and the settings in
  `examples/openapi-python-client.yaml`, for TypeScript with `openapi-typescript --default-non-nullable=false`.
- **Uploads** are [tus 1.0](../../formats/upload.md).

"""


@cache
def document() -> dict[str, Any]:
    """Return the OpenAPI document of a platform with default settings; temporary files are removed."""
    with TemporaryDirectory() as folder:
        platform = open_platform(Settings(data_folder=Path(folder)))
        try:
            made: dict[str, Any] = make_api(platform).openapi()
        finally:
            platform.database.close()
    return made


def api_pages() -> Mapping[str, str]:
    """Return the pages as Markdown by path."""
    openapi = document()
    by_tag: dict[str, list[tuple[str, str, Operation]]] = defaultdict(list)
    for path, method, operation in operations(openapi):
        by_tag[operation["tags"][0]].append((path, method, operation))
    pages = {f"{FOLDER}/{page_name(tag)}.md": _page(tag, listed) for tag, listed in by_tag.items()}
    schemas = openapi["components"]["schemas"]
    bodies = "\n".join(body_section(name, schemas[name]) for name in sorted(schemas))
    return {
        f"{FOLDER}/index.md": INDEX + _overview(by_tag),
        **pages,
        f"{FOLDER}/bodies.md": f"# Bodies\n\n{bodies}",
    }


def page_name(tag: str) -> str:
    """Return the name of the page of a noun."""
    return tag.replace(" ", "-").lower()


def _overview(by_tag: Mapping[str, list[tuple[str, str, Operation]]]) -> str:
    rows = (
        (
            f"**{method.upper()}**",
            f"[{code(path)}]({page_name(tag)}.md#{operation['operationId']})",
            operation["summary"],
        )
        for tag in sorted(by_tag)
        for path, method, operation in by_tag[tag]
    )
    return table(("", "path", ""), rows)


def _page(tag: str, listed: list[tuple[str, str, Operation]]) -> str:
    return f"# {tag.capitalize()}\n\n" + "\n".join(_operation(*operation) for operation in listed)


def _operation(path: str, method: str, operation: Operation) -> str:
    head = f"## {plain(operation['summary'])} {{#{operation['operationId']}}}"
    scopes = " · ".join(code(item) for item in next(iter(operation.get("security", ANYBODY)[0].values())))
    parts = [head, f"**{method.upper()}** {code(path)}", operation.get("description", ""), f"For: {scopes}"]
    parts += [table(("parameter", "in", "type", ""), map(_parameter, operation.get("parameters", ())))]
    parts += [f"Takes {item}" for item in _contents(operation.get("requestBody", {}))]
    parts += [table(("status", "answer", ""), _answers(operation)), _refusals(operation)]
    return "\n\n".join(part for part in parts if part) + "\n"


def _parameter(one: dict[str, Any]) -> tuple[str, str, str, str]:
    need = "" if one.get("required") else " (optional)"
    return code(one["name"]), one["in"] + need, type_of(one.get("schema", {})), plain(one.get("description", ""))


def _answers(operation: Operation) -> Iterator[tuple[str, str, str]]:
    for status, answer in operation["responses"].items():
        if int(status) < FIRST_REFUSAL:
            yield code(status), ", ".join(_contents(answer)), plain(answer.get("description", ""))


def _refusals(operation: Operation) -> str:
    refusals = [
        f"{status} {answer.get('description', '')}"
        for status, answer in operation["responses"].items()
        if int(status) >= FIRST_REFUSAL
    ]
    return f"Refusals as {body_link('Problem')}: {', '.join(refusals)}." if refusals else ""


def _contents(holder: Mapping[str, Any]) -> list[str]:
    """Return the media type and type of each body."""
    return [f"{code(kind)} {_content(content)}".strip() for kind, content in holder.get("content", {}).items()]


def _content(content: Mapping[str, Any]) -> str:
    schema = content.get("schema", {})
    return body_link(schema["$ref"]) if "$ref" in schema else type_of(schema) if schema else ""
