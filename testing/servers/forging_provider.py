"""A provider of OpenID Connect that forges answers as a test defines; it checks PKCE correctly.

**Conventions.** A test puts functions into `answers`, by path, that compute the answers. `requested` lists the paths in
order.
"""

import json
import threading
import time
from base64 import urlsafe_b64encode
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from hashlib import sha256
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit

from joserfc import jwt
from joserfc.jwk import KeySet, RSAKey

from services.runtime.oidc.settings import OidcSettings

Answer = tuple[int, dict[str, str], bytes]
CLIENT_ID = "stone"


def as_json(value: Any, status: int = 200) -> Answer:
    return status, {"Content-Type": "application/json"}, json.dumps(value).encode()


@cache
def signing_key(name: str) -> RSAKey:
    """Return a key of this id, cached because creating it takes longer than signing."""
    return RSAKey.generate_key(2048, {"kid": name})


@dataclass
class ForgingProvider:
    """A forging provider: `claims` and `header` override those of the next ID token; None removes a claim."""

    issuer: str = ""
    claims: dict[str, Any] = field(default_factory=dict)
    header: dict[str, Any] = field(default_factory=dict)
    key: RSAKey = field(default_factory=lambda: signing_key("first"))
    published: list[RSAKey] = field(default_factory=list)
    requested: list[str] = field(default_factory=list)
    answers: dict[str, Callable[["ForgingProvider", dict[str, str]], Answer]] = field(default_factory=dict)
    begun: dict[str, str] = field(default_factory=dict)
    _codes: dict[str, dict[str, str]] = field(default_factory=dict)

    def settings(self, **more: Any) -> OidcSettings:
        return OidcSettings(**{"issuer": self.issuer, "client_id": CLIENT_ID, "timeout_s": 20.0, **more})

    def approve(self, address: str, code: str = "code-1") -> dict[str, str]:
        """Sign in at this address and return the query of the answer, as an honest provider would send it."""
        self.begun = {name: values[0] for name, values in parse_qs(urlsplit(address).query).items()}
        self._codes[code] = self.begun
        return {"code": code, "state": self.begun["state"], "iss": self.issuer}

    def description(self) -> dict[str, Any]:
        paths = {"authorization_endpoint": "/authorize", "token_endpoint": "/token", "jwks_uri": "/keys"}
        return {"issuer": self.issuer, **{name: self.issuer + path for name, path in paths.items()}}

    def token(self, nonce: str) -> str:
        """Return an ID token with the forged values."""
        now = int(time.time())
        honest = {"iss": self.issuer, "aud": CLIENT_ID, "sub": "ada", "nonce": nonce, "iat": now, "exp": now + 300}
        claims = {name: value for name, value in (honest | self.claims).items() if value is not None}
        header = {"alg": "RS256", "kid": self.key.kid, **self.header}
        return jwt.encode(header, claims, self.key, algorithms=[header["alg"]])

    def redeem(self, form: dict[str, str]) -> Answer:
        """Redeem a code: it is valid once, and only with the verifier of its challenge."""
        begun = self._codes.pop(form.get("code", ""), None)
        digest = sha256(form.get("code_verifier", "").encode()).digest()
        challenge = urlsafe_b64encode(digest).rstrip(b"=").decode()
        if begun is None or begun["code_challenge"] != challenge or begun["code_challenge_method"] != "S256":
            return as_json({"error": "invalid_grant"}, 400)
        return as_json({"access_token": "x", "token_type": "Bearer", "id_token": self.token(begun["nonce"])})

    def answer(self, path: str, form: dict[str, str]) -> Answer:
        self.requested.append(path)
        if path in self.answers:
            return self.answers[path](self, form)
        if path == "/.well-known/openid-configuration":
            return as_json(self.description())
        if path == "/keys":
            return as_json(KeySet([*(self.published or [self.key])]).as_dict(private=False))
        return self.redeem(form) if path == "/token" else as_json({}, 404)


@contextmanager
def forging_provider() -> Iterator[ForgingProvider]:
    """Serve a forging provider during the block."""
    provider = ForgingProvider()

    class Asked(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self._say(provider.answer(urlsplit(self.path).path, {}))

        def do_POST(self) -> None:
            sent = parse_qs(self.rfile.read(int(self.headers.get("Content-Length", 0))).decode())
            shown = {"authorization": self.headers.get("Authorization", "")}
            self._say(provider.answer(self.path, {**{name: values[0] for name, values in sent.items()}, **shown}))

        def _say(self, answer: Answer) -> None:
            status, headers, content = answer
            self.send_response(status)
            for name, value in {"Content-Length": str(len(content)), **headers}.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *_: Any) -> None:
            """Log nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Asked)
    provider.issuer = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    try:
        yield provider
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
