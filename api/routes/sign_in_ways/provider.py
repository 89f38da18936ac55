"""Routes of signing in by a provider of OpenID Connect: the ways to sign in, to the provider, and back from it.

**Conventions.** A browser goes through these itself, so they answer with redirects: to the provider's own address, and
back to a page of ours, never elsewhere. The cookie holds the secret of this one sign-in; it is sent to these routes
only, and ends with the answer or after `LASTS_S`.
"""

from base64 import urlsafe_b64decode, urlsafe_b64encode
from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import RedirectResponse
from sqlalchemy.orm import Session

from api import audit
from api.answers import refusals
from api.deps import PlatformDep
from api.own_pages import LONGEST, own_page
from api.routes.sessions import as_caller, give_cookie, is_https
from api.schemas.sign_in import SignInWays
from api.views.people import sign_in_ways
from services.runtime.access import sessions
from services.runtime.oidc.accounts import AdmittedUser, admit
from services.runtime.oidc.provider import CodeAnswer, CodeRequest, Provider
from services.runtime.settings import Settings

router = APIRouter(prefix="/sign-in", tags=["people"])

COOKIE = "stone_sign_in"
COOKIE_PATH = "/api/v1/sign-in"
LASTS_S = 600
LONGEST_COOKIE = 64 + 4 * LONGEST

Back = Annotated[str, Query(max_length=LONGEST, description="Path of the page to return to.")]
Said = Annotated[str, Query(max_length=4096, description="Parameter of the provider's answer.")]


@router.get("", summary="List the ways to sign in")
def list_sign_in_ways(platform: PlatformDep) -> SignInWays:
    return sign_in_ways(platform.settings)


@router.get(
    "/oidc",
    status_code=302,
    summary="Redirect to the provider's sign-in page",
    responses=refusals(404, 502),
    response_class=RedirectResponse,
)
def start_oidc(request: Request, platform: PlatformDep, back: Back = "/") -> RedirectResponse:
    request.app.state.limits.admit_from(request, "sign-in by provider")
    begun, address = _provider(request).begin()
    answer = RedirectResponse(address, 302, headers={"Cache-Control": "no-store"})
    kept = f"{begun.secret}.{_url64(own_page(back))}"
    secure = is_https(platform.settings)
    answer.set_cookie(COOKIE, kept, LASTS_S, path=COOKIE_PATH, secure=secure, httponly=True, samesite="lax")
    return answer


@router.get(
    "/oidc/callback",
    status_code=303,
    summary="Finish the provider's sign-in",
    responses=refusals(400, 403, 404, 409, 502),
    response_class=RedirectResponse,
)
def finish_oidc(
    request: Request, platform: PlatformDep, code: Said = "", state: Said = "", iss: Said = "", error: Said = ""
) -> RedirectResponse:
    """Create the account at the first sign-in. The role follows the groups that the provider sends."""
    request.app.state.limits.admit_from(request, "answer of a provider")
    begun, back = _read_cookie(request.cookies.get(COOKIE, ""))
    identity = _provider(request).finish(begun, CodeAnswer(code, state, iss, error))
    with platform.database.transaction() as session:
        admitted = admit(session, identity, platform.settings.oidc)
        opened = sessions.open_session(session, admitted.user, platform.settings.api.session_s)
        _record(session, admitted, identity.issuer)
    answer = RedirectResponse(back, 303)
    give_cookie(answer, opened, platform.settings)
    _forget(answer, platform.settings)
    return answer


def _provider(request: Request) -> Provider:
    provider: Provider = request.app.state.provider
    return provider


def _read_cookie(kept: str) -> tuple[CodeRequest | None, str]:
    """Return the sign-in that this browser started, and the page to return to."""
    secret, _, page = kept.partition(".")
    if not secret or len(kept) > LONGEST_COOKIE:
        return None, "/"
    try:
        return CodeRequest(secret), own_page(urlsafe_b64decode(page + "=" * (-len(page) % 4)).decode())
    except ValueError:
        return None, "/"


def _url64(text: str) -> str:
    """Return the text in characters that a cookie's value may contain."""
    return urlsafe_b64encode(text.encode()).rstrip(b"=").decode()


def _record(session: Session, admitted: AdmittedUser, issuer: str) -> None:
    user, who = admitted.user, as_caller(admitted.user)
    if admitted.is_new:
        audit.record(session, who, "user.add", user.id, facts={"name": user.name, "role": user.role, "issuer": issuer})
    elif admitted.role_before != user.role:
        facts = {"role": user.role, "before": admitted.role_before, "issuer": issuer}
        audit.record(session, who, "user.change", user.id, facts=facts)
    audit.record(session, who, "session.open", user.id, facts={"issuer": issuer})


def _forget(answer: RedirectResponse, settings: Settings) -> None:
    answer.delete_cookie(COOKIE, path=COOKIE_PATH, httponly=True, samesite="lax", secure=is_https(settings))
