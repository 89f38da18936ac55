"""Deletes expired sessions, tokens and invitations, failed sign-in counts, old addresses and idempotent replies.

**Conventions.** Done by the sweeper. What ended is refused from its last second on, whether its row is gone or not. A
token stays listed for `TOKENS_SHOWN_NS` after its end, so that its owner sees why a program is refused.
"""

from sqlalchemy import delete, or_

from services.runtime.access.login_throttle import ADDRESSES_KEPT_NS, FORGOTTEN_NS
from services.runtime.orm import FailedSignInRow, IdempotentReply, SignInAddress, TeamInvitation, Token, WebSession
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform

TOKENS_SHOWN_NS = 30 * 86_400 * 10**9
REPLIES_KEPT_NS = 86_400 * 10**9
INVITATIONS_SHOWN_NS = 30 * 86_400 * 10**9


def forget_ended(platform: Platform) -> int:
    """Delete such rows; how many went. Any number may run at once."""
    now, idle_ns = now_ns(), int(platform.settings.api.session_idle_s * 1e9)
    ended = (
        delete(WebSession).where(or_(WebSession.expires_ns <= now, WebSession.used_ns <= now - idle_ns)),
        delete(Token).where(Token.expires_ns <= now - TOKENS_SHOWN_NS),
        delete(TeamInvitation).where(TeamInvitation.expires_ns <= now - INVITATIONS_SHOWN_NS),
        delete(FailedSignInRow).where(FailedSignInRow.failed_ns <= now - FORGOTTEN_NS),
        delete(SignInAddress).where(SignInAddress.used_ns <= now - ADDRESSES_KEPT_NS),
        delete(IdempotentReply).where(IdempotentReply.created_ns <= now - REPLIES_KEPT_NS),
    )
    with platform.database.transaction() as session:
        return sum(session.execute(some).rowcount for some in ended)  # type: ignore[attr-defined]
