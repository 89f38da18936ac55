"""Error pages: refusals of the API in words, with the next step.

**Conventions.** Status, code and sentence come from the problem (`api/problems.py`). A visitor without access is sent
to the sign-in page and back. Below `/api/` the response stays JSON, except for the provider's sign-in, which a browser
opens itself; so does any request that accepts JSON only.
"""

import json

from fastapi import Request
from fastapi.responses import Response

from api.deps import platform_of
from api.views.people import TO_PROVIDER, sign_in_ways
from web.first_steps import first_password_of
from web.rendering import caller_of, page

NEXT = {
    400: "Start again.",
    403: "Ask an administrator for the role, or sign in as a user who has it.",
    404: "It may have been deleted, or you may not have access. The menu above lists what you can open.",
    409: "It changed in the meantime. Go back, reload the page and try again.",
    422: "Go back and correct the address or the form.",
    426: "Update the client; /downloads/ shows the command.",
    429: "Wait a moment, then load the page again.",
    502: "Try again in a minute; if it persists, give your administrator the request ID.",
    503: "The platform is busy, or a component is unavailable. Try again in a minute.",
    507: "The platform's disk is full; an administrator has to free space.",
}


def shown(request: Request, answer: Response) -> Response:
    """Return the response to a refusal or fault, as a page for browsers."""
    if not _is_page(request.url.path) or not _reads_pages(request):
        return answer
    problem = json.loads(bytes(answer.body))
    if problem["status"] == 401:
        return _sign_in(request)
    if problem["code"] == "not_found" and not _is_known(request):
        problem |= {
            "title": "This page does not exist",
            "detail": f"Nothing is at the address {request.url.path[:200]}.",
        }
        advice = "Check the address, or choose from the menu above."
        return page(request, caller_of(request), "problem.html", status=404, problem=problem, advice=advice)
    advice = NEXT.get(problem["status"], "Reload the page; if it persists, give your administrator the request ID.")
    made = page(request, caller_of(request), "problem.html", status=problem["status"], problem=problem, advice=advice)
    if wait := answer.headers.get("Retry-After"):
        made.headers["Retry-After"] = wait
    return made


def _is_known(request: Request) -> bool:
    """Return whether a page has an address of this form."""
    return "route" in request.scope


def _sign_in(request: Request) -> Response:
    ways, first = sign_in_ways(platform_of(request).settings), first_password_of(request)
    caller, back = caller_of(request), _here(request)
    return page(request, caller, "sign_in.html", status=401, back=back, ways=ways, first_password=first)


def _here(request: Request) -> str:
    query = request.url.query
    return f"{request.url.path}?{query}" if query else request.url.path


def _is_page(path: str) -> bool:
    return path.startswith(TO_PROVIDER) or not path.startswith(("/api/", "/assets/"))


def _reads_pages(request: Request) -> bool:
    return "text/html" in request.headers.get("accept", "")
