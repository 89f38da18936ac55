"""Certificates of servers that tests start."""

import subprocess
from pathlib import Path


def self_signed(folder: Path, name: str = "localhost") -> Path:
    """Create a self-signed certificate of this host name and return its path; its key is `key.pem` beside it."""
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", f"/CN={name}"]
    files = ["-keyout", str(folder / "key.pem"), "-out", str(folder / "certificate.pem")]
    subprocess.run([*command, "-addext", f"subjectAltName=DNS:{name}", *files], check=True, capture_output=True)
    return folder / "certificate.pem"
