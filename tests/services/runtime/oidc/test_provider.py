"""A provider that is away, slow, malformed or false costs a refusal, bounded in time and size."""

import gzip
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import pytest
from pydantic import SecretStr

from services.runtime.oidc import metadata
from services.runtime.oidc.metadata import LONGEST_BYTES
from services.runtime.oidc.provider import AT_ONCE, CodeAnswer, CodeRequest, Provider
from services.runtime.oidc.settings import OidcSettings
from stone.errors import StoneError
from testing.refusals import refused_as
from testing.servers.forging_provider import Answer, ForgingProvider, as_json, forging_provider, signing_key

OWN, DESCRIPTION = "http://127.0.0.1:8080", "/.well-known/openid-configuration"


@pytest.fixture
def forger() -> Iterator[ForgingProvider]:
    with forging_provider() as provider:
        yield provider


def signed_in(forger: ForgingProvider, provider: Provider | None = None, **changed: str) -> str:
    """The subject that a whole sign-in brings; `changed` are parts of the answer that are other than they should be."""
    provider = provider or Provider(forger.settings(), OWN)
    request, address = provider.begin()
    said = forger.approve(address) | changed
    answer = CodeAnswer(said["code"], said["state"], said["iss"], said.get("error", ""))
    return provider.finish(request, answer).subject


def says(answer: Answer) -> Callable[[ForgingProvider, dict[str, str]], Answer]:
    return lambda *_: answer


def described(forger: ForgingProvider, **changed: Any) -> None:
    forger.answers[DESCRIPTION] = lambda asked, _: as_json(asked.description() | changed)


def test_an_honest_sign_in_is_asked_for_with_state_nonce_and_the_challenge_of_a_verifier(
    forger: ForgingProvider,
) -> None:
    assert signed_in(forger) == "ada"
    begun = forger.begun
    assert begun["redirect_uri"] == f"{OWN}/api/v1/sign-in/oidc/callback"
    assert (begun["response_type"], begun["code_challenge_method"]) == ("code", "S256")
    assert len({begun["state"], begun["nonce"], begun["code_challenge"]}) == 3
    assert all(len(begun[name]) == 43 for name in ("state", "nonce", "code_challenge"))


def test_no_two_sign_ins_share_a_secret(forger: ForgingProvider) -> None:
    provider = Provider(forger.settings(), OWN)
    made = [provider.begin()[0] for _ in range(5)]
    assert len({one.state for one in made} | {one.verifier for one in made} | {one.nonce for one in made}) == 15


def test_a_secret_of_the_client_is_shown_as_the_provider_wants_it(forger: ForgingProvider) -> None:
    shown: list[dict[str, str]] = []

    def look(asked: ForgingProvider, form: dict[str, str]) -> Answer:
        shown.append(form)
        return asked.redeem(form)

    forger.answers["/token"] = look
    settings = forger.settings(client_secret=SecretStr("a:b c"))
    assert signed_in(forger, Provider(settings, OWN)) == "ada"
    assert shown[0]["authorization"].startswith("Basic ")
    assert "client_secret" not in shown[0]
    described(forger, token_endpoint_auth_methods_supported=["client_secret_post"])
    assert signed_in(forger, Provider(settings, OWN)) == "ada"
    assert shown[1]["client_secret"] == "a:b c"
    assert shown[1]["authorization"] == ""


def test_a_client_that_the_provider_does_not_know_is_a_matter_of_the_settings(forger: ForgingProvider) -> None:
    forger.answers["/token"] = says(as_json({"error": "invalid_client"}, 401))
    with refused_as("provider_answer", match="401 'invalid_client'"):
        signed_in(forger)


def test_without_an_issuer_there_is_no_provider() -> None:
    provider = Provider(OidcSettings(), OWN)
    with refused_as("no_provider"):
        provider.begin()
    with refused_as("no_provider"):
        provider.finish(None, CodeAnswer())


@pytest.mark.parametrize(
    "changed",
    [{"state": "another"}, {"state": ""}, {"iss": "https://evil.example"}, {"code": ""}, {"code": "x" * 5000}],
)
def test_an_answer_to_another_sign_in_is_refused(forger: ForgingProvider, changed: dict[str, str]) -> None:
    with refused_as("sign_in_state"):
        signed_in(forger, **changed)
    assert "/token" not in forger.requested


def test_an_answer_to_a_browser_that_began_nothing_is_refused(forger: ForgingProvider) -> None:
    with refused_as("sign_in_state"):
        Provider(forger.settings(), OWN).finish(None, CodeAnswer("code", "state"))


def test_a_no_of_the_provider_is_passed_on_without_what_could_be_markup(forger: ForgingProvider) -> None:
    with refused_as("provider_refused", match="'access_deniedb'"):
        signed_in(forger, error="access_denied<b>")


def test_a_code_is_good_once(forger: ForgingProvider) -> None:
    provider = Provider(forger.settings(), OWN)
    request, address = provider.begin()
    said = forger.approve(address)
    answer = CodeAnswer(said["code"], said["state"])
    assert provider.finish(request, answer).subject == "ada"
    with refused_as("provider_refused", match="invalid_grant"):
        provider.finish(request, answer)


def test_a_stolen_code_is_worth_nothing_in_another_browser(forger: ForgingProvider) -> None:
    """The thief's browser has a state of its own, and no verifier of the code's challenge."""
    provider = Provider(forger.settings(), OWN)
    stolen = forger.approve(provider.begin()[1])
    thief = CodeRequest("of the thief")
    with refused_as("provider_refused", match="invalid_grant"):
        provider.finish(thief, CodeAnswer(stolen["code"], thief.state))


@pytest.mark.parametrize("claims", [{"nonce": "another"}, {"aud": "another"}, {"iss": "https://evil.example"}])
def test_an_id_token_for_another_sign_in_signs_nobody_in(forger: ForgingProvider, claims: dict[str, Any]) -> None:
    forger.claims = claims
    with refused_as("id_token_refused"):
        signed_in(forger)


def test_a_key_that_is_changed_is_read_again_but_not_at_every_false_token(
    forger: ForgingProvider, monkeypatch: pytest.MonkeyPatch
) -> None:
    provider = Provider(forger.settings(), OWN)
    assert signed_in(forger, provider) == "ada"
    forger.key = signing_key("second")
    for _ in range(3):
        with refused_as("id_token_refused"):
            signed_in(forger, provider)
    assert forger.requested.count("/keys") == 1
    monkeypatch.setattr(metadata, "REREAD_S", -1.0)
    assert signed_in(forger, provider) == "ada"
    assert forger.requested.count("/keys") == 2
    assert forger.requested.count(DESCRIPTION) == 1


def test_a_secret_key_among_the_published_ones_is_not_used(forger: ForgingProvider) -> None:
    listed = {"keys": [{"kty": "oct", "k": "c2VjcmV0", "kid": "first"}]}
    forger.answers["/keys"] = says(as_json(listed))
    with refused_as("provider_answer"):
        signed_in(forger)


@pytest.mark.parametrize(
    "changed",
    [
        {"issuer": "https://evil.example"},
        {"issuer": None},
        {"token_endpoint": "http://evil.example/token"},
        {"token_endpoint": "file:///etc/passwd"},
        {"token_endpoint": "https://user:word@evil.example/"},
        {"token_endpoint": "https://[::1"},
        {"token_endpoint": 7},
        {"jwks_uri": None},
        {"jwks_uri": "http://169.254.169.254/latest"},
        {"authorization_endpoint": "javascript:alert(1)"},
        {"authorization_endpoint": ""},
    ],
)
def test_a_description_with_another_issuer_or_an_unsafe_address_is_refused(
    forger: ForgingProvider, changed: dict[str, Any]
) -> None:
    described(forger, **changed)
    with refused_as("provider_answer"):
        signed_in(forger)


def test_a_slash_at_the_issuers_end_makes_another_issuer(forger: ForgingProvider) -> None:
    settings = replace(forger.settings(), issuer=f"{forger.issuer}/")
    with refused_as("provider_answer"):
        Provider(settings, OWN).begin()


@pytest.mark.parametrize(
    "answer",
    [
        as_json([]),
        as_json({}, 500),
        (200, {}, b"\xff<html>"),
        (200, {}, b"[" * 100_000),
        (200, {}, b"{" + b" " * (LONGEST_BYTES + 1) + b"}"),
        (200, {"Content-Encoding": "gzip"}, gzip.compress(b"{}")),
        (302, {"Location": "http://127.0.0.1:1/"}, b""),
    ],
    ids=["list", "500", "bytes", "deep", "long", "gzip", "redirect"],
)
@pytest.mark.parametrize("path", [DESCRIPTION, "/keys", "/token"])
def test_a_malformed_answer_is_refused_at_every_address(forger: ForgingProvider, path: str, answer: Answer) -> None:
    forger.answers[path] = says(answer)
    with pytest.raises(StoneError, check=lambda error: error.code in ("provider_answer", "provider_refused")):
        signed_in(forger)


@pytest.mark.parametrize(
    "keys", [[], "keys", [None], [{}], [{"kty": "RSA"}], [{"kty": "RSA", "n": "!", "e": 3}], [{"kty": 5}], [{}] * 65]
)
def test_keys_that_are_none_are_refused(forger: ForgingProvider, keys: Any) -> None:
    forger.answers["/keys"] = says(as_json({"keys": keys}))
    with refused_as("provider_answer"):
        signed_in(forger)


def test_a_token_endpoint_without_a_token_is_refused(forger: ForgingProvider) -> None:
    forger.answers["/token"] = says(as_json({"id_token": 7}))
    with refused_as("provider_answer"):
        signed_in(forger)


def test_a_provider_that_is_down_is_away() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    settings = OidcSettings(issuer=f"http://127.0.0.1:{port}", client_id="stone", timeout_s=20.0)
    with refused_as("provider_unavailable"):
        Provider(settings, OWN).begin()


def dripping(listening: socket.socket) -> None:
    """Answer a byte every twentieth of a second, for as long as somebody listens."""
    connection, _ = listening.accept()
    with connection, suppress(OSError):
        connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 100000\r\n\r\n")
        while True:
            connection.sendall(b" ")
            time.sleep(0.05)


def test_a_provider_that_answers_a_byte_at_a_time_is_given_up() -> None:
    """Each byte comes within the time for one read; the whole never does."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        thread = threading.Thread(target=dripping, args=(listening,), daemon=True)
        thread.start()
        settings = OidcSettings(f"http://127.0.0.1:{listening.getsockname()[1]}", "stone", timeout_s=0.5)
        with refused_as("provider_unavailable", match=r"within 0\.5 s"):
            Provider(settings, OWN).begin()
        thread.join()


def test_sign_ins_that_wait_for_a_provider_leave_threads_for_everybody_else(forger: ForgingProvider) -> None:
    provider = Provider(forger.settings(), OWN)
    for _ in range(AT_ONCE):
        provider._places.acquire()
    with refused_as("provider_unavailable"):
        provider.begin()
