"""The methods that a path supports: the `Allow` header of a 405 (RFC 9110 §15.5.6).

**Conventions.** They come from the OpenAPI document, because the router finds only the first route of a path.
"""

import re
from collections.abc import Iterator

from fastapi import Request

PARAMETER = re.compile(r"\\{\w+\\}")
PATH = r"\{path\}"  # a path parameter that includes slashes


def allowed(request: Request) -> str:
    """Return the methods of the request's path for the header, or an empty string if there is no such path."""
    return ", ".join(sorted(set(_methods(request))))


def _methods(request: Request) -> Iterator[str]:
    for template, methods in request.app.openapi()["paths"].items():
        pattern = PARAMETER.sub("[^/]+", re.escape(template).replace(PATH, ".+"))
        if re.fullmatch(pattern, request.url.path):
            yield from (method.upper() for method in methods)
