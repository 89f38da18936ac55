"""A receiver of webhooks as a process: every request becomes a line of a file, flushed before the reply.

    python -m testing.servers.webhook_receiver PORT FILE [CERTIFICATE]

**Conventions.** The path determines the reply: `/status/503` that status, `/redirect` a redirect to `/hooks`,
`/endless` an endless body, `/drip` an endless first line, any other path 200.
"""

import json
import os
import ssl
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from testing.servers.process import ServerProcess, answers, free_port


class Receiver(BaseHTTPRequestHandler):
    """The handler of one request."""

    file = Path("received")

    def do_POST(self) -> None:
        length = int(self.headers["content-length"])
        body = self.rfile.read(length)
        if len(body) < length:  # its sender was killed in the middle
            self.close_connection = True
            return
        heads = {name.lower(): value for name, value in self.headers.items()}
        line = json.dumps({"path": self.path, "headers": heads, "body": body.decode()}) + "\n"
        descriptor = os.open(self.file, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
        os.write(descriptor, line.encode())
        os.fsync(descriptor)
        os.close(descriptor)
        self._answer()

    def _answer(self) -> None:
        if self.path == "/drip":
            self._write_for_ever(b"HTTP/1.1 ", b" ")
        elif self.path == "/endless":
            self._write_for_ever(b"HTTP/1.1 200 OK\r\n\r\n", b"x" * 65_536)
        else:
            status = int(self.path.rpartition("/")[2]) if self.path.startswith("/status/") else 200
            self.send_response(307 if self.path == "/redirect" else status)
            self.send_header("Location", "/hooks")
            self.send_header("Content-Length", "0")
            self.end_headers()

    def _write_for_ever(self, head: bytes, piece: bytes) -> None:
        """Write until the other side disconnects."""
        self.close_connection = True
        try:
            self.wfile.write(head)
            while True:
                self.wfile.write(piece)
                time.sleep(0.2 if self.path == "/drip" else 0)
        except OSError:
            return

    def log_message(self, *_: object) -> None:
        """Log nothing."""


class WebhookReceiver:
    """The receiver's process; `url(path)` is the address for deliveries, `received()` lists the requests."""

    def __init__(self, folder: Path, certificate: Path | None = None) -> None:
        self._scheme = "http" if certificate is None else "https"
        self.port = free_port()
        self._file = folder / "received"
        command: list[str | Path] = [
            sys.executable,
            "-m",
            "testing.servers.webhook_receiver",
            str(self.port),
            self._file,
        ]
        command += [] if certificate is None else [certificate]
        root = Path(__file__).resolve().parents[2]
        self.process = ServerProcess(command, folder, lambda: answers(self.port), environment={"PYTHONPATH": str(root)})

    def url(self, path: str = "/hooks") -> str:
        return f"{self._scheme}://localhost:{self.port}{path}"

    def received(self) -> list[dict[str, Any]]:
        """Return the received requests, except a line that is being written."""
        text = self._file.read_text("utf-8") if self._file.exists() else ""
        return [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]


@contextmanager
def webhook_receiver(folder: Path, certificate: Path | None = None) -> Iterator[WebhookReceiver]:
    """Run a receiver, by TLS if there is a certificate (`testing/servers/certificates.py`)."""
    receiver = WebhookReceiver(folder, certificate)
    receiver.process.start()
    try:
        yield receiver
    finally:
        receiver.process.kill()


if __name__ == "__main__":
    Receiver.file = Path(sys.argv[2])
    server = ThreadingHTTPServer(("127.0.0.1", int(sys.argv[1])), Receiver)
    if len(sys.argv) > 3:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(sys.argv[3], Path(sys.argv[3]).with_name("key.pem"))
        server.socket = context.wrap_socket(server.socket, server_side=True, do_handshake_on_connect=False)
    server.serve_forever()
