"""The API's own process serves the pages, unless it is told not to; the API is the same either way.

Catches alone a process that serves pages though it was told not to.
"""

import os
import socket
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from services.runtime.database.migrate import upgrade
from services.runtime.settings import Settings
from testing.stone_serve import environment, until

pytestmark = pytest.mark.whole


@pytest.mark.parametrize(("pages", "status"), [("true", 200), ("false", 404)])
def test_pages_are_served_unless_they_are_switched_off(tmp_path: Path, pages: str, status: int) -> None:
    data = tmp_path / "data"
    upgrade(Settings(data_folder=data))
    with socket.create_server(("127.0.0.1", 0)) as listening:
        process = subprocess.Popen(
            [sys.executable, "-m", "services.runtime.embedded.api_process", str(listening.fileno()), "1"],
            pass_fds=[listening.fileno()],
            env=environment(data, STONE_DATA_FOLDER=str(data), STONE_API__PAGES=pages, PYTHONPATH=os.getcwd()),
            stdout=subprocess.DEVNULL,
        )
        try:
            with httpx.Client(base_url=f"http://127.0.0.1:{listening.getsockname()[1]}", timeout=300.0) as client:
                until(lambda: client.get("/healthz").status_code == 200)
                assert client.get("/", headers={"Accept": "text/html"}).status_code == status
                assert client.get("/api/v1/sequences").json()["items"] == []
        finally:
            process.terminate()
            assert process.wait(300) is not None
