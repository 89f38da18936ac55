"""The manual: the docs site as `make docs` builds it, served from its folder to all visitors.

**Conventions.** Its pages contain inline scripts and styles of the theme; each page's policy names the hashes of its
own scripts. Only files inside the folder are sent, by any name or link.
"""

import re
from base64 import b64encode
from functools import lru_cache
from hashlib import sha256
from pathlib import Path

from fastapi import APIRouter, Request, Response
from fastapi.responses import RedirectResponse
from starlette.exceptions import HTTPException
from starlette.staticfiles import StaticFiles

from api.deps import Looker
from api.errors import NotFoundError
from web.rendering import page

router = APIRouter()
MANUAL = Path(__file__).parents[1] / "manual"
INDEX = "index.html"
POLICY = (
    "default-src 'none'; script-src 'self'{hashes}; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "font-src 'self'; connect-src 'self'; worker-src 'self'; base-uri 'self'; frame-ancestors 'none'"
)
INLINE = re.compile(r"<script(?![^>]*\bsrc=)[^>]*>(.*?)</script>", re.DOTALL)
CACHE = "public, max-age=300"


@router.get("/docs")
def add_slash() -> Response:
    return RedirectResponse("/docs/", 308)


@router.get("/docs/{path:path}")
async def show_docs(path: str, request: Request, caller: Looker) -> Response:
    """Return a file of the manual; without a manual, a page with the build instructions. Raises `NotFoundError`."""
    if not (MANUAL / INDEX).is_file():
        return RedirectResponse("/docs/", 307) if path else page(request, caller, "docs_missing.html")
    name = f"{path}{INDEX}" if path.endswith("/") or not path else path
    try:
        answer = await StaticFiles(directory=MANUAL).get_response(name, request.scope)
    except HTTPException:
        raise NotFoundError("page of the manual", path) from None
    answer.headers["Cache-Control"] = CACHE
    if name.endswith(".html"):
        answer.headers["Content-Security-Policy"] = _policy(MANUAL / name, (MANUAL / name).stat().st_mtime_ns)
    return answer


@lru_cache(512)
def _policy(file: Path, changed_ns: int) -> str:
    """Return the policy of the page as of that modification time."""
    scripts = INLINE.findall(file.read_text("utf-8"))
    hashes = sorted({b64encode(sha256(script.encode()).digest()).decode() for script in scripts})
    return POLICY.format(hashes="".join(f" 'sha256-{digest}'" for digest in hashes))
