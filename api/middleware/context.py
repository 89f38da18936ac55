"""Per-request context: the request's id and its caller.

**Conventions.** A client's id is used if it matches [A-Za-z0-9-]{1,64}, else a new id is created. The response, every
log line, the audit log and problems contain it.
"""

import re
from contextvars import ContextVar
from secrets import token_hex

COOKIE = "stone_session"
ID = re.compile(r"[A-Za-z0-9-]{1,64}")

_request_id: ContextVar[str] = ContextVar("request_id", default="")


def request_id() -> str:
    """Return the id of the current request, or an empty string outside a request."""
    return _request_id.get()


def begin(offered: str) -> str:
    """Start a request with the offered id if it is valid, else with a new id; return the id."""
    chosen = offered if ID.fullmatch(offered) else token_hex(16)
    _request_id.set(chosen)
    return chosen
