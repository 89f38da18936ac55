"""The OpenAPI document as one HTML page, without scripts or foreign hosts.

**Conventions.** Everything shown comes from the document and is escaped; the page's one style is allowed by its hash.
"""

import json
import re
from base64 import b64encode
from hashlib import sha256
from html import escape
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from api.openapi import Operation, operations

router = APIRouter(tags=["probes"])

STYLE = """:root{color-scheme:light dark}
body{font:16px/1.5 sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}code,pre{font-family:monospace}
summary{cursor:pointer;padding:.2rem 0}b{display:inline-block;width:5rem;text-transform:uppercase}
pre{background:#8882;padding:.6rem;overflow:auto}"""
STYLE_HASH = b64encode(sha256(STYLE.encode()).digest()).decode()
POLICY = f"default-src 'none'; style-src 'sha256-{STYLE_HASH}'; frame-ancestors 'none'; base-uri 'none'"

IN_BACKTICKS = re.compile(r"`([^`]+)`")
ANYBODY = ({"": ["anybody"]},)


@router.get("/docs", summary="Show the API reference", response_class=HTMLResponse)
def show_reference(request: Request) -> HTMLResponse:
    document: dict[str, Any] = request.app.openapi()
    by_tag: dict[str, list[str]] = {}
    for path, method, operation in operations(document):
        shown = _operation(document, path, method, operation)
        by_tag.setdefault(operation["tags"][0], []).append(shown)
    body = "".join(f"<h2>{escape(tag)}</h2>{''.join(shown)}" for tag, shown in sorted(by_tag.items()))
    title, description = escape(document["info"]["title"]), _prose(document["info"]["description"])
    head = '<meta charset="utf-8"><meta name="viewport" content="width=device-width,initial-scale=1">'
    head += f"<title>{title}</title><style>{STYLE}</style>"
    page = f"<head>{head}</head><body><h1>{title}</h1><p>{description}</p>{body}</body>"
    return HTMLResponse(f'<!doctype html><html lang="en">{page}</html>', headers={"Content-Security-Policy": POLICY})


def _operation(document: dict[str, Any], path: str, method: str, operation: Operation) -> str:
    """Return one operation, folded: permissions, inputs and responses."""
    permissions = " ".join(next(iter(operation.get("security", ANYBODY)[0].values())))
    parameters = "".join(_parameter(each) for each in operation.get("parameters", ()))
    answers = "".join(
        f"<li><code>{status}</code> {_prose(answer.get('description', ''))}{_example(document, answer)}</li>"
        for status, answer in operation["responses"].items()
    )
    body = _example(document, operation.get("requestBody", {}))
    inside = f"<p>{_prose(operation.get('description', ''))}</p><p>For: <code>{escape(permissions)}</code></p>"
    inside += f"<ul>{parameters}</ul>{body}<ul>{answers}</ul>"
    head = f"<b>{method}</b> <code>{escape(path)}</code> {_prose(operation['summary'])}"
    return f"<details><summary>{head}</summary>{inside}</details>"


def _prose(text: str) -> str:
    """Return a docstring's text as HTML, with backticks as code."""
    return IN_BACKTICKS.sub(r"<code>\1</code>", escape(text))


def _parameter(parameter: dict[str, Any]) -> str:
    need = "" if parameter.get("required") else " (optional)"
    description = _prose(parameter.get("description", ""))
    return f"<li><code>{escape(parameter['name'])}</code> in {escape(parameter['in'])}{need} {description}</li>"


def _example(document: dict[str, Any], holder: dict[str, Any]) -> str:
    """Return the first example of the schema of `holder`, if it has one."""
    for content in holder.get("content", {}).values():
        name = content.get("schema", {}).get("$ref", "").rpartition("/")[2]
        examples = document["components"]["schemas"].get(name, {}).get("examples")
        if examples:
            return f"<pre>{escape(json.dumps(examples[0], indent=1))}</pre>"
    return ""
