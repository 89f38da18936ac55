"""Routes of browser sessions: sign in, sign out, change the password, show the caller.

**Conventions.** The cookie is HttpOnly, Secure if the public URL is https, and SameSite=Lax, so that links from mails
keep the session. Requests that change data also require the CSRF token. Sign-in requires none, because a forged sign-in
changes nothing of value. An unknown name takes as long as a wrong password.
"""

from math import ceil

import structlog
from fastapi import APIRouter, Request, Response

from api import audit
from api.answers import refusals
from api.deps import AccountHolder, Anybody, Caller, PlatformDep, Reader
from api.errors import ApiError, wrong_password
from api.middleware.context import COOKIE
from api.middleware.limits import address_of
from api.paging import Page, whole
from api.schemas.base import instant
from api.schemas.people import BrowserItem, MeItem, PasswordBody, SessionItem, SignInBody
from api.views.people import browsers_of
from services.runtime.access import issuing, login_throttle, passwords, sessions, users
from services.runtime.access.ending import end_all, end_browsers
from services.runtime.access.issuing import SessionSecrets
from services.runtime.access.login_throttle import SignInTry
from services.runtime.orm import User
from services.runtime.platform import Platform
from services.runtime.settings import Settings
from stone.errors import Refused

router = APIRouter(tags=["people"])
log = structlog.get_logger(__name__)


@router.post("/sessions", status_code=201, summary="Sign in a browser", responses=refusals(401, 403))
def create_session(body: SignInBody, request: Request, response: Response, platform: PlatformDep) -> SessionItem:
    if not platform.settings.api.passwords:
        raise Refused("passwords_off", "password sign-in is disabled (STONE_API__PASSWORDS); sign in with the provider")
    tried = _count_try(request, platform, body.name)
    with platform.database.reading() as session:
        user = users.find_user(session, body.name)
    is_right = sessions.is_password_of(user, body.password.get_secret_value())
    if user is None or not is_right:
        log.warning("sign-in refused", name=user.name if user else "")  # no name: perhaps a password in the wrong field
        raise wrong_password()
    with platform.database.transaction() as session:
        if issuing.lock_user(session, user.id).password_hash != user.password_hash:  # it changed during the check
            raise wrong_password()
        login_throttle.take_back(session, tried, user.id)
        opened = sessions.open_session(session, user, platform.settings.api.session_s)
        audit.record(session, as_caller(user), "session.open", user.id)
    give_cookie(response, opened, platform.settings)
    return SessionItem(
        user_id=user.id,
        name=user.name,
        role=user.role,
        csrf_token=opened.csrf_token,
        expires_at=instant(opened.expires_ns),
    )


@router.delete("/sessions/current", status_code=204, summary="Sign out this browser", responses=refusals(409))
def delete_current_session(caller: Anybody, response: Response, platform: PlatformDep) -> None:
    if not caller.is_session:
        raise ApiError("conflict", "a token is not a session; revoke it with DELETE /tokens/{id}")
    with platform.database.transaction() as session:
        sessions.close_session(session, caller.credential_id)
        audit.record(session, caller, "session.close", caller.user_id)
    response.delete_cookie(COOKIE, path="/", httponly=True, samesite="lax", secure=is_https(platform.settings))


@router.get("/sessions", summary="List the browsers that you are signed in with, newest first")
def list_sessions(caller: Reader, platform: PlatformDep) -> Page[BrowserItem]:
    with platform.database.reading() as session:
        return whole(browsers_of(session, caller.user_id, caller.credential_id))


@router.delete("/sessions/others", status_code=204, summary="Sign out all your other browsers")
def delete_other_sessions(caller: AccountHolder, platform: PlatformDep) -> None:
    """Sign out all browsers but the calling one; a call with a token signs out all of them. If one of them approved a
    program that has not fetched its token, the program gets none."""
    with platform.database.transaction() as session:
        closed = end_browsers(session, caller.user_id, caller.credential_id)
        audit.record(session, caller, "session.close_others", caller.user_id, facts={"closed": closed})


@router.get("/me", summary="Show the caller and their permissions")
async def show_caller(caller: Reader) -> MeItem:
    # Async, because the caller is already identified and a thread would cost more than the call.
    return MeItem.of(caller, scopes=sorted(caller.scopes), csrf_token=caller.csrf_token or None)


@router.put("/me/password", status_code=204, summary="Change your password", responses=refusals(401))
def change_password(body: PasswordBody, caller: AccountHolder, request: Request, platform: PlatformDep) -> None:
    tried = _count_try(request, platform, caller.name)
    with platform.database.reading() as session:
        user = session.get_one(User, caller.user_id)
    if not sessions.is_password_of(user, body.current.get_secret_value()):
        raise wrong_password()
    password_hash = passwords.hash_password(body.new.get_secret_value(), caller.name)
    with platform.database.transaction() as session:
        users.change_password(session, session.get_one(User, caller.user_id), password_hash)
        if body.ends_tokens:
            end_all(session, caller.user_id)
        login_throttle.take_back(session, tried, caller.user_id)
        audit.record(session, caller, "user.password", caller.user_id, facts={"ends_tokens": body.ends_tokens})


def _count_try(request: Request, platform: Platform, name: str) -> SignInTry:
    """Count the attempt and return it. Raises `rate_limited`, `guessed_too_often`."""
    with platform.database.reading() as session:
        tried = login_throttle.try_at(session, name, address_of(request))
    request.app.state.limits.admit_sign_in(request, tried)
    with platform.database.transaction() as session:
        wait_s = login_throttle.count_try(session, tried)
    if wait_s:
        log.warning("sign-in rejected after too many wrong passwords", name=name)
        raise too_many_failed_sign_ins(ceil(wait_s))
    return tried


def give_cookie(response: Response, opened: SessionSecrets, settings: Settings) -> None:
    """Set the session's secret as a cookie of the browser."""
    lasts_s = int(settings.api.session_s)
    secure = is_https(settings)
    response.set_cookie(COOKIE, opened.secret, lasts_s, path="/", secure=secure, httponly=True, samesite="lax")
    response.headers["Cache-Control"] = "no-store"


def is_https(settings: Settings) -> bool:
    """Return whether the public URL is https, so that cookies are Secure."""
    return settings.api.url.startswith("https://")


def as_caller(user: User) -> Caller:
    """Return the user who is signing in as a caller without scopes."""
    return Caller(user.id, user.name, user.role, frozenset(), is_session=True)


def too_many_failed_sign_ins(retry_after_s: int) -> ApiError:
    return ApiError(
        "guessed_too_often",
        f"too many wrong passwords; try again in {retry_after_s} s, or ask an administrator",
        {"Retry-After": str(retry_after_s)},
    )
