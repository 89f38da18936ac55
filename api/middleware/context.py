"""Per-request context: the request's id and its caller.

**Conventions.** An id from outside is taken if it is [A-Za-z0-9-]{1,64}, else one is made. It is in the answer, in
every log line, in the audit log and in problems.
"""

import re
from contextvars import ContextVar
from secrets import token_hex

COOKIE = "stone_session"
ID = re.compile(r"[A-Za-z0-9-]{1,64}")

_request_id: ContextVar[str] = ContextVar("request_id", default="")


def request_id() -> str:
    """The id of the request being answered; empty outside of one."""
    return _request_id.get()


def begin(offered: str) -> str:
    """Start a request under the id it offers, if that is one."""
    chosen = offered if ID.fullmatch(offered) else token_hex(16)
    _request_id.set(chosen)
    return chosen
