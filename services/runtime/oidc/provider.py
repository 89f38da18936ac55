"""The sign-in provider of a platform: the browser's redirect to it, and the identity on its return.

**Conventions.** State, nonce and PKCE verifier (RFC 7636, S256) are derived from one secret that only the browser has,
in a cookie. So an answer in another browser is refused, strangers cause no rows, and any process of the API can handle
the answer.
"""

import math
import time
from base64 import b64encode, urlsafe_b64encode
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import sha256
from hmac import compare_digest
from secrets import token_urlsafe
from threading import BoundedSemaphore
from typing import Any
from urllib.parse import quote_plus, urlencode, urlsplit

from joserfc import jws, jwt
from joserfc.errors import JoseError
from joserfc.jwk import KeySet

from services.runtime.oidc.errors import provider_answer, provider_unavailable
from services.runtime.oidc.metadata import KeptMetadata, ProviderMetadata, send_form
from services.runtime.oidc.settings import OidcSettings
from stone.errors import PlatformFaultError, Refused

# Verification of ID tokens (OpenID Connect Core 1.0, section 3.1.3.7).
#
# **Conventions.** Only public keys verify signatures: `none` and `HS…` are in no list (RFC 8725, 3.1). A missing claim,
# or a claim of another type, is refused like a wrong claim.


ALGORITHMS = ("RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "ES512")
LEEWAY_S = 60.0
OLDEST_S = 600.0
LONGEST_TOKEN = 64 * 2**10
LONGEST_SUBJECT = 255
UNREADABLE = (JoseError, ValueError, TypeError, KeyError, AttributeError, RecursionError)


@dataclass(frozen=True)
class TokenExpectation:
    """The expected content of a token: its issuer, its audience, and the request that it answers."""

    issuer: str
    client_id: str
    nonce: str


@dataclass(frozen=True)
class VerifiedIdentity:
    """An identity verified by the provider, with its claims."""

    issuer: str
    subject: str
    claims: Mapping[str, Any]


def verified(
    token: str, keys: Callable[[str | None], KeySet], expected: TokenExpectation, now_s: float | None = None
) -> VerifiedIdentity:
    """Return the signed-in identity; `keys` returns the provider's keys for a key id. Raises `id_token_refused`."""
    claims = _signed_claims(token, keys)
    _check_parties(claims, expected)
    _check_times(claims, time.time() if now_s is None else now_s)
    nonce, subject = claims.get("nonce"), claims.get("sub")
    if not isinstance(nonce, str) or not compare_digest(nonce.encode(), expected.nonce.encode()):
        raise id_token_refused("belongs to another request: its nonce differs")
    if not isinstance(subject, str) or not 0 < len(subject) <= LONGEST_SUBJECT or not subject.isprintable():
        raise id_token_refused(f"has no valid subject: sub must be 1 to {LONGEST_SUBJECT} characters")
    return VerifiedIdentity(expected.issuer, subject, claims)


def _signed_claims(token: str, keys: Callable[[str | None], KeySet]) -> dict[str, Any]:
    if len(token) > LONGEST_TOKEN:
        raise id_token_refused(f"is longer than {LONGEST_TOKEN} characters")
    try:
        header = jws.extract_compact(token.encode()).headers()
        algorithm, key_id = header.get("alg"), header.get("kid")
        if algorithm not in ALGORITHMS:
            raise id_token_refused(f"is signed by {str(algorithm)[:20]!r}, which is not one of {ALGORITHMS}")
        known = keys(key_id if isinstance(key_id, str) else None)
        return jwt.decode(token, known, algorithms=list(ALGORITHMS)).claims
    except UNREADABLE as error:
        raise id_token_refused(f"is not signed by a key of the provider ({type(error).__name__})") from None


def _check_parties(claims: Mapping[str, Any], expected: TokenExpectation) -> None:
    issuer, audience, party = claims.get("iss"), claims.get("aud"), claims.get("azp")
    if issuer != expected.issuer:
        raise id_token_refused(f"comes from the issuer {str(issuer)[:100]!r}, not {expected.issuer!r}")
    audiences = audience if isinstance(audience, list) else [audience]
    if expected.client_id not in audiences or not all(isinstance(member, str) for member in audiences):
        raise id_token_refused(f"is for {str(audience)[:100]!r}, not for {expected.client_id!r}")
    if party != expected.client_id and (party is not None or len(audiences) > 1):
        raise id_token_refused(f"was issued to {str(party)[:100]!r}, not to {expected.client_id!r} (azp)")


def _check_times(claims: Mapping[str, Any], now_s: float) -> None:
    ends_s, made_s, begins_s = (_instant(claims, name) for name in ("exp", "iat", "nbf"))
    if ends_s is None or made_s is None:
        raise id_token_refused("has no issue or expiry time (iat, exp)")
    if now_s > ends_s + LEEWAY_S:
        raise id_token_refused(f"expired {now_s - ends_s:.0f} s ago; check the clocks of both machines")
    if not now_s - OLDEST_S <= made_s <= now_s + LEEWAY_S or (begins_s or 0.0) > now_s + LEEWAY_S:
        raise id_token_refused(f"was issued {now_s - made_s:.0f} s ago; check the clocks of both machines")


def _instant(claims: Mapping[str, Any], name: str) -> float | None:
    value = claims.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if math.isfinite(value) and abs(value) < 1e12 else None


CALLBACK = "/api/v1/sign-in/oidc/callback"
AT_ONCE = 8
LONGEST_CODE = 4096


@dataclass(frozen=True)
class CodeRequest:
    """A sign-in that a browser started; its cookie contains `secret`."""

    secret: str

    @property
    def state(self) -> str:
        return _derive("state", self.secret)

    @property
    def nonce(self) -> str:
        return _derive("nonce", self.secret)

    @property
    def verifier(self) -> str:
        return _derive("verifier", self.secret)

    @property
    def challenge(self) -> str:
        """The verifier's S256 challenge."""
        return _url64(sha256(self.verifier.encode()).digest())


@dataclass(frozen=True)
class CodeAnswer:
    """The browser's answer from the provider; missing parameters are empty."""

    code: str = ""
    state: str = ""
    issuer: str = ""
    error: str = ""


class Provider:
    """The provider of these settings, if there is one; at most `AT_ONCE` threads of a process query it at once."""

    def __init__(self, settings: OidcSettings, own_url: str) -> None:
        self._settings, self._kept = settings, KeptMetadata(settings)
        self._callback = own_url.rstrip("/") + CALLBACK
        self._places = BoundedSemaphore(AT_ONCE)

    def begin(self) -> tuple[CodeRequest, str]:
        """Return a new request, and the provider's address for the browser.

        Raises `no_provider`, `provider_unavailable`, `provider_answer`.
        """
        with self._limited():
            where = self._kept.metadata().authorization_url
        request = CodeRequest(token_urlsafe(32))
        parameters = {
            "response_type": "code",
            "client_id": self._settings.client_id,
            "redirect_uri": self._callback,
            "scope": " ".join(self._settings.scopes.split()),
            "state": request.state,
            "nonce": request.nonce,
            "code_challenge": request.challenge,
            "code_challenge_method": "S256",
        }
        return request, f"{where}{'&' if '?' in where else '?'}{urlencode(parameters)}"

    def finish(self, request: CodeRequest | None, answer: CodeAnswer) -> VerifiedIdentity:
        """Return the identity that this answer to the browser's request proves.

        Raises `sign_in_state`, `provider_refused`, `id_token_refused`, and as `begin` does.
        """
        with self._limited():
            _refuse_foreign(request, answer, self._settings.issuer)
            assert request is not None  # noqa: S101  (a strange one otherwise)
            token = self._id_token(self._kept.metadata(), request, answer.code)
            expected = TokenExpectation(self._settings.issuer, self._settings.client_id, request.nonce)
            return verified(token, self._kept.keys, expected)

    def _id_token(self, metadata: ProviderMetadata, request: CodeRequest, code: str) -> str:
        form = {
            "grant_type": "authorization_code",
            "code": code,
            "redirect_uri": self._callback,
            "code_verifier": request.verifier,
        }
        proof, headers = self._credentials(metadata)
        status, reply = send_form(metadata.token_url, form | proof, headers, self._settings.timeout_s)
        if status != 200:
            raise _refusal(status, _printable(reply.get("error")))
        token = reply.get("id_token")
        if not isinstance(token, str):
            raise provider_answer("token endpoint", "gave no id_token")
        return token

    def _credentials(self, metadata: ProviderMetadata) -> tuple[dict[str, str], dict[str, str]]:
        """Return the form fields and headers that authenticate this client (RFC 6749, 2.3.1)."""
        name, secret = self._settings.client_id, self._settings.client_secret.get_secret_value()
        if not secret:
            return {"client_id": name}, {}
        if metadata.takes_secret_in_body:
            return {"client_id": name, "client_secret": secret}, {}
        basic = b64encode(f"{quote_plus(name)}:{quote_plus(secret)}".encode()).decode()
        return {}, {"Authorization": f"Basic {basic}"}

    @contextmanager
    def _limited(self) -> Iterator[None]:
        if not self._settings.issuer:
            raise Refused(
                "no_provider", "this platform has no sign-in provider; an administrator can set STONE_OIDC__ISSUER"
            )
        if not self._places.acquire(blocking=False):
            host = urlsplit(self._settings.issuer).hostname or ""
            raise provider_unavailable(host, f"{AT_ONCE} sign-ins are waiting for it already")
        try:
            yield
        finally:
            self._places.release()


def _refuse_foreign(request: CodeRequest | None, answer: CodeAnswer, issuer: str) -> None:
    if request is None:
        raise sign_in_state("this browser has no sign-in in progress")
    if not compare_digest(answer.state.encode(), request.state.encode()):
        raise sign_in_state("the answer belongs to another sign-in")
    if answer.issuer and answer.issuer != issuer:
        raise sign_in_state("the answer comes from another provider")
    if answer.error:
        raise provider_refused(_printable(answer.error))
    if not 0 < len(answer.code) <= LONGEST_CODE:
        raise sign_in_state("the answer contains no code")


def _refusal(status: int, error: str) -> Refused | PlatformFaultError:
    """Return the error: a foreign code is the browser's mistake; any other error is in our settings."""
    if error == "invalid_grant":
        return provider_refused(error)
    reason = f"returned status {status} {error!r}; check client id and secret"
    return provider_answer("token endpoint", reason)


def _printable(error: Any) -> str:
    """Return the printable part of a provider's error word."""
    return (
        "".join(
            character for character in error if character.isascii() and (character.isalnum() or character in "_-.")
        )[:80]
        if isinstance(error, str)
        else ""
    )


def _derive(purpose: str, secret: str) -> str:
    return _url64(sha256(f"{purpose} {secret}".encode()).digest())


def _url64(content: bytes) -> str:
    return urlsafe_b64encode(content).rstrip(b"=").decode()


def sign_in_state(reason: str) -> Refused:
    return Refused("sign_in_state", f"{reason}; start again at the sign-in page, in one window, within ten minutes")


def provider_refused(error: str) -> Refused:
    return Refused(
        "provider_refused",
        f"the provider answered {error[:80]!r}; sign in there with an account that may use STONE"
        f"the provider answered {error[:80]!r}; sign in there with an account that may use this platform",
    )


def id_token_refused(reason: str) -> Refused:
    return Refused("id_token_refused", f"sign-in failed: the ID token {reason[:300]}")
