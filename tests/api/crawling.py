"""Asks for all that can be asked for: each GET and HEAD of the document, with every id that exists, in every form.

**Conventions.** What a path or query may hold is known by the parameter's name (`Known`); a path with a parameter that
nobody knows is an error, so that a new route is crawled. Query parameters vary one at a time, those that are required
in all combinations. Cursors and links are followed. Streams of events are read to their end.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any
from urllib.parse import urlencode

import httpx

from api.openapi import operations

Known = Mapping[str, Sequence[str]]
LINK = re.compile(r"/api/v1/[A-Za-z0-9._~/?&=%+@-]+")
REQUEST_ID = "crawl"  # chosen by the caller, or no two answers would be alike


@dataclass(frozen=True)
class Answer:
    """What came back, whole."""

    asked: str
    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def is_json(self) -> bool:
        return "json" in self.headers.get("content-type", "")

    def heads(self) -> str:
        """Without the body's own length, which tells nothing that the body does not and is any number."""
        own = ("content-length", str(len(self.body)))
        return "\n".join(f"{name}: {value}" for name, value in self.headers.items() if (name, value) != own)


class Crawl:
    """Answers by what was asked, one caller."""

    def __init__(self, client: httpx.Client, document: dict[str, Any], known: Known) -> None:
        self._client, self._document, self._known = client, document, known
        self.answers: dict[str, Answer] = {}

    def run(self) -> dict[str, Answer]:
        for path, method, operation in operations(self._document):
            if method in ("get", "head"):
                for url in urls_of(path, operation, self._known):
                    self._ask(method.upper(), url)
        return self.answers

    def _ask(self, method: str, url: str) -> None:
        asked = f"{method} {url}"
        if asked in self.answers:
            return
        answer = self._client.request(method, url, headers={"X-Request-Id": REQUEST_ID})
        found = Answer(asked, answer.status_code, dict(answer.headers), answer.content)
        self.answers[asked] = found
        for link in links_of(found):
            self._ask("GET", link)


def urls_of(path: str, operation: Mapping[str, Any], known: Known) -> Iterator[str]:
    """Every way to ask; none where nothing of a kind exists."""
    parameters = operation.get("parameters", [])
    queries = [one for one in parameters if one["in"] == "query"]
    required = [one["name"] for one in queries if one.get("required")]
    in_path = re.findall(r"{(\w+)}", path)
    choices = [known[name] for name in in_path] + [values_of(one, known) for one in queries if one.get("required")]
    for chosen in product(*choices):
        said = dict(zip([*in_path, *required], chosen, strict=True))
        url = path.format_map(said)
        asked = {name: said[name] for name in required}
        yield _with(url, asked)
        for one in queries:
            if one["name"] not in required:
                yield from (_with(url, {**asked, one["name"]: value}) for value in values_of(one, known))


def values_of(parameter: Mapping[str, Any], known: Known) -> Sequence[str]:
    """What a query parameter may hold: what its schema lists, else what is known of its name."""
    schema, name = parameter["schema"], parameter["name"]
    listed = [value for one in (schema, *schema.get("anyOf", [])) for value in one.get("enum", [])]
    if schema.get("type") == "boolean":
        return ["true", "false"]
    return [str(value) for value in listed] or known.get(name, ())


def links_of(answer: Answer) -> Iterator[str]:
    """Addresses of the API in the body and the headers of JSON answers, and the next page."""
    if not answer.is_json or "openapi" in answer.asked:
        return
    yield from LINK.findall(answer.headers.get("link", ""))
    record = json.loads(answer.body) if answer.body else None
    yield from (link for text in strings_in(record) for link in LINK.findall(text) if text.startswith("/api/v1/"))
    if isinstance(record, dict) and record.get("next"):
        url, _, query = answer.asked.removeprefix("GET ").partition("?")
        kept = [part for part in query.split("&") if part and not part.startswith("cursor=")]
        yield "?".join([url, "&".join([*kept, urlencode({"cursor": record["next"]})])])


def strings_in(record: object) -> Iterator[str]:
    if isinstance(record, str):
        yield record
    elif isinstance(record, dict):
        yield from (text for one in record.values() for text in strings_in(one))
    elif isinstance(record, list):
        yield from (text for one in record for text in strings_in(one))


def _with(url: str, asked: Mapping[str, str]) -> str:
    return f"{url}?{urlencode(asked)}" if asked else url
