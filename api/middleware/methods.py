"""The methods a path allows: the `Allow` header of a 405 (RFC 9110 §15.5.6).

**Conventions.** Read off the OpenAPI document, since the router knows the first route of a path only.
"""

import re
from collections.abc import Iterator

from fastapi import Request

PARAMETER = re.compile(r"\\{\w+\\}")
PATH = r"\{path\}"  # a path within something, slashes and all


def allowed(request: Request) -> str:
    """The methods of the request's path, as the header says them; empty where there is no such path."""
    return ", ".join(sorted(set(_methods(request))))


def _methods(request: Request) -> Iterator[str]:
    for template, methods in request.app.openapi()["paths"].items():
        pattern = PARAMETER.sub("[^/]+", re.escape(template).replace(PATH, ".+"))
        if re.fullmatch(pattern, request.url.path):
            yield from (method.upper() for method in methods)
