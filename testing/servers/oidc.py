"""A provider of OpenID Connect as a process: `oidc-provider-mock`, which accepts any name in its form."""

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import quote

import httpx
from pydantic import SecretStr

from services.runtime.oidc.settings import OidcSettings
from testing.servers.process import ServerProcess, answers, free_port

CLIENT_ID = "stone"
SECRET = SecretStr("any secret will do")


@dataclass
class OidcServer(ServerProcess):
    """A provider process: `know` sets a subject's claims; `settings` are those of a platform that uses it."""

    port: int = 0

    @property
    def issuer(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def know(self, subject: str, **claims: Any) -> None:
        """Set the claims of this subject's later ID tokens."""
        answer = httpx.put(f"{self.issuer}/users/{quote(subject)}", json=claims, trust_env=False)
        answer.raise_for_status()

    def settings(self, **more: Any) -> OidcSettings:
        return OidcSettings(
            **{
                "issuer": self.issuer,
                "client_id": CLIENT_ID,
                "client_secret": SECRET,
                "title": "Field Robotics Lab",
                **more,
            }
        )

    def approve(self, address: str, subject: str) -> str:
        """Sign in at `address` as this subject and return the redirect target."""
        answer = httpx.post(address, data={"sub": subject}, trust_env=False)
        return answer.headers["location"]


@contextmanager
def running_oidc() -> Iterator[OidcServer]:
    """Run a provider during the block."""
    port = free_port()
    command = (
        sys.executable,
        "-W",
        "ignore",
        "-m",
        "oidc_provider_mock",
        "--port",
        str(port),
        "--require-nonce",
        "true",
    )
    with TemporaryDirectory() as folder:
        server = OidcServer(command, Path(folder), lambda: answers(port), port=port)
        server.start()
        try:
            yield server
        finally:
            server.kill()


def lab_groups() -> Mapping[str, str]:
    """Return the groups of a lab by role, as named in the settings."""
    return {"administrators": "stone-admins", "curators": "field-team", "participants": "students, guests"}
