"""An ID token is believed only as a whole: signature, parties, times, nonce, subject."""

import hmac
import json
import time
from base64 import urlsafe_b64encode
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from joserfc import jwt
from joserfc.jwk import ECKey, KeySet, RSAKey

from services.runtime.oidc.provider import TokenExpectation, VerifiedIdentity, verified
from testing.refusals import refused_as

ISSUER, CLIENT, NONCE, NOW_S = "https://id.lab.example", "stone", "n-1", 1_800_000_000.0
RSA = RSAKey.generate_key(2048, {"kid": "rsa"})
EC = ECKey.generate_key("P-256", {"kid": "ec"})
STRANGER = RSAKey.generate_key(2048, {"kid": "rsa"})
PUBLIC = KeySet.import_key_set(KeySet([RSA, EC]).as_dict(private=False))
EXPECTED = TokenExpectation(ISSUER, CLIENT, NONCE)
HONEST = {"iss": ISSUER, "aud": CLIENT, "sub": "ada", "nonce": NONCE, "iat": NOW_S - 1, "exp": NOW_S + 300}


def signed(key: Any = RSA, alg: str = "RS256", header: dict[str, Any] | None = None, **claims: Any) -> str:
    """A token of these claims over the honest ones; `None` leaves one out."""
    said = {name: value for name, value in (HONEST | claims).items() if value is not None}
    return jwt.encode({"alg": alg, "kid": key.kid, **(header or {})}, said, key, algorithms=[alg])


def read(token: str) -> VerifiedIdentity:
    return verified(token, lambda _: PUBLIC, EXPECTED, NOW_S)


def unsigned(alg: str, **claims: Any) -> str:
    parts = ({"alg": alg, "kid": "rsa"}, HONEST | claims)
    return ".".join(urlsafe_b64encode(json.dumps(one).encode()).rstrip(b"=").decode() for one in parts) + "."


@pytest.mark.parametrize(("key", "alg"), [(RSA, "RS256"), (RSA, "PS384"), (EC, "ES256")])
def test_a_token_of_the_providers_key_says_who_signed_in(key: Any, alg: str) -> None:
    identity = read(signed(key, alg, groups=["field-team"]))
    assert (identity.issuer, identity.subject, identity.claims["groups"]) == (ISSUER, "ada", ["field-team"])


@pytest.mark.parametrize(
    "claims",
    [
        {"iss": "https://id.lab.example/"},
        {"iss": None},
        {"aud": "other"},
        {"aud": None},
        {"aud": []},
        {"aud": [CLIENT, 3]},
        {"aud": [CLIENT, "other"]},
        {"aud": [CLIENT, "other"], "azp": "other"},
        {"azp": "other"},
        {"exp": NOW_S - 61},
        {"exp": None},
        {"exp": "soon"},
        {"exp": True},
        {"iat": None},
        {"iat": NOW_S + 120},
        {"iat": NOW_S - 3600},
        {"nbf": NOW_S + 120},
        {"nonce": "n-2"},
        {"nonce": None},
        {"nonce": ["n-1"]},
        {"sub": None},
        {"sub": ""},
        {"sub": 7},
        {"sub": "a\nb"},
        {"sub": "a" * 256},
    ],
)
def test_a_claim_that_is_missing_or_wrong_is_refused(claims: dict[str, Any]) -> None:
    with refused_as("id_token_refused"):
        read(signed(**claims))


def test_several_audiences_are_accepted_only_where_the_token_was_given_to_us() -> None:
    assert read(signed(aud=[CLIENT, "other"], azp=CLIENT)).subject == "ada"


@pytest.mark.parametrize("alg", ["none", "None", "NONE", "HS256"])
def test_an_algorithm_without_a_public_key_is_refused(alg: str) -> None:
    with refused_as("id_token_refused"):
        read(unsigned(alg))


def test_a_token_signed_with_the_public_key_as_a_password_is_refused() -> None:
    """The public key, known to all, used as the secret of HS256 (RFC 8725, 2.1)."""
    body = unsigned("HS256").rstrip(".")
    proof = hmac.digest(RSA.as_pem(private=False), body.encode(), "sha256")
    with refused_as("id_token_refused"):
        read(f"{body}.{urlsafe_b64encode(proof).rstrip(b'=').decode()}")


def test_another_key_of_the_same_name_is_refused() -> None:
    with refused_as("id_token_refused"):
        read(signed(STRANGER))


def test_a_key_that_the_token_brings_itself_is_not_used() -> None:
    header = {"jwk": STRANGER.as_dict(private=False)}
    with refused_as("id_token_refused"):
        read(signed(STRANGER, header=header))


def test_a_changed_byte_anywhere_is_refused() -> None:
    head, claims, signature = signed().split(".")
    forged = urlsafe_b64encode(json.dumps(HONEST | {"sub": "eve"}).encode()).rstrip(b"=").decode()
    with refused_as("id_token_refused"):
        read(f"{head}.{forged}.{signature}")
    assert read(f"{head}.{claims}.{signature}").subject == "ada"


@given(st.text(max_size=200) | st.from_regex(r"[A-Za-z0-9_-]{0,60}\.[A-Za-z0-9_-]{0,60}\.[A-Za-z0-9_-]{0,60}"))
def test_what_is_no_token_is_refused_and_never_a_fault(text: str) -> None:
    with refused_as("id_token_refused"):
        read(text)


def test_without_a_clock_given_the_time_is_now() -> None:
    now = time.time()
    assert verified(signed(iat=now, exp=now + 60), lambda _: PUBLIC, EXPECTED).subject == "ada"
