"""Error pages: refusals of the API in words, with what to do next.

**Conventions.** The same table decides (`api/problems.py`): status, code and sentence are the problem's own. Somebody
who is not signed in and is not shown a thing is asked to sign in, and comes back to it. Below `/api/` nothing changes,
but where a browser itself goes to sign in with a provider; nor does it for whoever asks for JSON.
"""

import json

from fastapi import Request
from fastapi.responses import Response

from api.deps import platform_of
from api.schemas.sign_in import SignInWays
from api.views.people import TO_PROVIDER, sign_in_ways
from web.rendering import caller_of, page

NEXT = {
    400: "Begin again.",
    403: "Ask an administrator for the role, or sign in as somebody who has it.",
    404: "It may have been deleted, or belong to somebody else. The lists above show what you can see.",
    409: "Go back, look at how it stands now, and decide again.",
    422: "Go back and correct the address or the form.",
    426: "Install the client anew; the page /downloads/ says the line.",
    429: "Wait a moment, then load the page again.",
    502: "Try again in a minute; if it stays, tell your administrator the request's id.",
    503: "The platform is busy or a part of it is away. Try again in a minute.",
    507: "The platform's disk is full; its administrator has to make room.",
}


def shown(request: Request, answer: Response) -> Response:
    """The answer to a refusal or fault, as a page for whoever reads pages."""
    if not _is_page(request.url.path) or not _reads_pages(request):
        return answer
    problem = json.loads(bytes(answer.body))
    if problem["status"] == 401:
        return page(request, caller_of(request), "sign_in.html", status=401, back=_here(request), ways=_ways(request))
    advice = NEXT.get(problem["status"], "Load the page again; if it stays, tell your administrator the request's id.")
    made = page(request, caller_of(request), "problem.html", status=problem["status"], problem=problem, advice=advice)
    if wait := answer.headers.get("Retry-After"):
        made.headers["Retry-After"] = wait
    return made


def _ways(request: Request) -> SignInWays:
    return sign_in_ways(platform_of(request).settings)


def _here(request: Request) -> str:
    query = request.url.query
    return f"{request.url.path}?{query}" if query else request.url.path


def _is_page(path: str) -> bool:
    return path.startswith(TO_PROVIDER) or not path.startswith(("/api/", "/assets/"))


def _reads_pages(request: Request) -> bool:
    return "text/html" in request.headers.get("accept", "")
