"""Verification of ID tokens (OpenID Connect Core 1.0, section 3.1.3.7).

**Conventions.** Signatures are by public keys alone: `none` and `HS…` are in no list (RFC 8725, 3.1). A claim that is
missing, or of another type, is as bad as a wrong one.
"""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from hmac import compare_digest
from typing import Any

from joserfc import jws, jwt
from joserfc.errors import JoseError
from joserfc.jwk import KeySet

from services.runtime.oidc.errors import IdTokenRefusedError

ALGORITHMS = ("RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "ES512")
LEEWAY_S = 60.0
OLDEST_S = 600.0
LONGEST_TOKEN = 64 * 2**10
LONGEST_SUBJECT = 255
UNREADABLE = (JoseError, ValueError, TypeError, KeyError, AttributeError, RecursionError)


@dataclass(frozen=True)
class TokenExpectation:
    """What a token must say: who made it, for whom, and in answer to which request."""

    issuer: str
    client_id: str
    nonce: str


@dataclass(frozen=True)
class VerifiedIdentity:
    """Somebody whom the provider vouches for, and what it says of them."""

    issuer: str
    subject: str
    claims: Mapping[str, Any]


def verified(
    token: str, keys: Callable[[str | None], KeySet], expected: TokenExpectation, now_s: float | None = None
) -> VerifiedIdentity:
    """Who signed in. `keys` gives the provider's, for the id that the token names. Raises `IdTokenRefusedError`."""
    claims = _signed_claims(token, keys)
    _check_parties(claims, expected)
    _check_times(claims, time.time() if now_s is None else now_s)
    nonce, subject = claims.get("nonce"), claims.get("sub")
    if not isinstance(nonce, str) or not compare_digest(nonce.encode(), expected.nonce.encode()):
        raise IdTokenRefusedError("answers another request: its nonce is not the one that was sent")
    if not isinstance(subject, str) or not 0 < len(subject) <= LONGEST_SUBJECT or not subject.isprintable():
        raise IdTokenRefusedError(f"names nobody: sub must be 1 to {LONGEST_SUBJECT} characters")
    return VerifiedIdentity(expected.issuer, subject, claims)


def _signed_claims(token: str, keys: Callable[[str | None], KeySet]) -> dict[str, Any]:
    if len(token) > LONGEST_TOKEN:
        raise IdTokenRefusedError(f"is longer than {LONGEST_TOKEN} characters")
    try:
        header = jws.extract_compact(token.encode()).headers()
        algorithm, key_id = header.get("alg"), header.get("kid")
        if algorithm not in ALGORITHMS:
            raise IdTokenRefusedError(f"is signed by {str(algorithm)[:20]!r}, which is not one of {ALGORITHMS}")
        known = keys(key_id if isinstance(key_id, str) else None)
        return jwt.decode(token, known, algorithms=list(ALGORITHMS)).claims
    except UNREADABLE as error:
        raise IdTokenRefusedError(f"is not signed by a key of the provider ({type(error).__name__})") from None


def _check_parties(claims: Mapping[str, Any], expected: TokenExpectation) -> None:
    issuer, audience, party = claims.get("iss"), claims.get("aud"), claims.get("azp")
    if issuer != expected.issuer:
        raise IdTokenRefusedError(f"is by the issuer {str(issuer)[:100]!r}, not {expected.issuer!r}")
    audiences = audience if isinstance(audience, list) else [audience]
    if expected.client_id not in audiences or not all(isinstance(one, str) for one in audiences):
        raise IdTokenRefusedError(f"is for {str(audience)[:100]!r}, not for {expected.client_id!r}")
    if party != expected.client_id and (party is not None or len(audiences) > 1):
        raise IdTokenRefusedError(f"was given to {str(party)[:100]!r}, not to {expected.client_id!r} (azp)")


def _check_times(claims: Mapping[str, Any], now_s: float) -> None:
    ends_s, made_s, begins_s = (_instant(claims, name) for name in ("exp", "iat", "nbf"))
    if ends_s is None or made_s is None:
        raise IdTokenRefusedError("does not say when it was made and ends (iat, exp)")
    if now_s > ends_s + LEEWAY_S:
        raise IdTokenRefusedError(f"ended {now_s - ends_s:.0f} s ago; is the clock of one of the machines wrong?")
    if not now_s - OLDEST_S <= made_s <= now_s + LEEWAY_S or (begins_s or 0.0) > now_s + LEEWAY_S:
        raise IdTokenRefusedError(f"was made {now_s - made_s:.0f} s ago; is the clock of one of the machines wrong?")


def _instant(claims: Mapping[str, Any], name: str) -> float | None:
    value = claims.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if math.isfinite(value) and abs(value) < 1e12 else None
