"""Routes by which a program signs in with a browser's help (RFC 8628): request codes, approve, fetch the token.

**Conventions.** An unauthenticated program requests two codes, shows one to a person, and polls with the other until
the person decides at `/device`. Only a browser's session can approve: a token belongs to a program, and would create
another token that outlives it. A token never has more rights than its approver.
"""

from fastapi import APIRouter, Request, Response

from api import audit
from api.answers import refusals
from api.deps import AccountHolder, Caller, PlatformDep
from api.errors import ApiError, NotFoundError
from api.middleware.limits import address_of
from api.routes.tokens import authority_of_caller
from api.schemas.people import IssuedToken
from api.schemas.sign_in import DeviceBody, DeviceCodesItem, DeviceDecision, DeviceTokenBody
from services.runtime.access import device_grants, issuing
from services.runtime.access.device_grants import DevicePoll, DeviceRequest
from services.runtime.orm import User

router = APIRouter(prefix="/device-grants", tags=["people"])


@router.post("", status_code=201, summary="Create the codes for a program's sign-in", responses=refusals(400))
def create_device_grant(
    body: DeviceBody, request: Request, response: Response, platform: PlatformDep
) -> DeviceCodesItem:
    """Create two codes: a person types `user_code` at `url`; `device_code` is the program's secret."""
    request.app.state.limits.admit_from(request, "device grant")
    device_request = DeviceRequest(body.name, address_of(request).removeprefix("address "), tuple(body.scopes))
    with platform.database.transaction() as session:
        codes = device_grants.begin_grant(session, device_request)
    response.headers["Cache-Control"] = "no-store"
    url = f"{platform.settings.api.url.rstrip('/')}/device"
    with_code = f"{url}?code={codes.user_code}"
    return DeviceCodesItem.of(codes, url=url, url_with_code=with_code, interval_s=device_grants.INTERVAL_S)


@router.post("/decision", status_code=204, summary="Approve or deny a program", responses=refusals(404, 409))
def decide_device_grant(body: DeviceDecision, caller: AccountHolder, request: Request, platform: PlatformDep) -> None:
    """Approve or deny. An approved program gets a token of the caller, with the requested scopes that the caller holds.
    If the browser's session ends before the program fetches the token, it gets none. A token cannot approve (403
    `browser_only`).
    """
    if body.approves and not caller.is_session:
        sentence = "a token cannot approve a program; open /device in a signed-in browser"
        raise ApiError("browser_only", sentence)
    request.app.state.limits.admit_guess(caller.user_id)
    with platform.database.transaction() as session:
        authority = authority_of_caller(session, caller, platform.settings.api.token_s)
        grant = device_grants.find_waiting(session, body.user_code, is_locked=True)
        if grant is None:
            raise NotFoundError("waiting program with the code", body.user_code)
        scopes = device_grants.scopes_for(grant, authority.scopes)
        facts = {"name": grant.name, "address": grant.address, "scopes": scopes}
        if body.approves:
            issuing.refuse_too_many(session, caller.user_id)
            device_grants.approve(grant, authority, caller.credential_id)
        else:
            grant.is_denied = True
        audit.record(session, caller, "device.approve" if body.approves else "device.deny", grant.id, facts=facts)


@router.post("/token", status_code=201, summary="Fetch the token of an approved program", responses=refusals(403))
def take_device_token(body: DeviceTokenBody, response: Response, platform: PlatformDep) -> IssuedToken:
    """Return the token, once: 400 `authorization_pending` until a person decides; 429 `slow_down` if the client polls
    too often.
    """
    with platform.database.transaction() as session:
        polled = device_grants.poll(session, body.device_code.get_secret_value(), platform.settings.api.token_s)
        if polled.token is not None:
            facts = {"scopes": polled.token.scopes, "name": polled.token.name}
            owner = session.get_one(User, polled.token.user_id)
            audit.record(session, _as_holder(owner), "token.issue", polled.token.id, facts=facts)
    response.headers["Cache-Control"] = "no-store"
    return _issued(polled)


def _issued(polled: DevicePoll) -> IssuedToken:
    """Return the token. Raises `authorization_pending`, `slow_down`, `access_denied`, `expired_token`."""
    if polled.state == "slow_down":
        wait_s = device_grants.INTERVAL_S
        sentence = f"this program polled less than {wait_s} s ago; poll again in {wait_s} s"
        raise ApiError("slow_down", sentence, {"Retry-After": str(wait_s)})
    if polled.state == "pending":
        raise ApiError("authorization_pending", "this program has not been approved yet; poll again after interval_s")
    if polled.state == "denied":
        raise ApiError("access_denied", "this program was denied; to approve it, start the login again")
    if polled.token is None:
        sentence = "this device code is unknown, expired (after 10 minutes) or already used; start the login again"
        raise ApiError("expired_token", sentence)
    return IssuedToken.of(polled.token, secret=polled.secret)


def _as_holder(user: User) -> Caller:
    return Caller(user.id, user.name, user.role, frozenset(), is_session=False)
