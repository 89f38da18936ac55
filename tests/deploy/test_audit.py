"""The audit of dependencies says what it found out, and never that all is well when nobody answered."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

AUDIT = Path(__file__).resolve().parents[2] / "deploy" / "audit.py"
SOUND = {"dependencies": [{"name": "numpy", "version": "2.4.6", "vulns": []}], "fixes": []}
FAULT = {"id": "PYSEC-2026-1", "fix_versions": ["2.4.7"], "aliases": ["CVE-2026-1"], "description": "…"}
FAULTY = {"dependencies": [{"name": "numpy", "version": "2.4.6", "vulns": [FAULT]}], "fixes": []}
CLEAN_PAGES = {"vulnerabilities": {}, "metadata": {"dependencies": {"total": 3}}}
VIA = {"title": "runs what it reads", "url": "https://example.org/advisories/GHSA-1", "severity": "high"}
FAULTY_PAGES = {**CLEAN_PAGES, "vulnerabilities": {"three": {"via": [VIA, "esbuild"]}}}
AWAY = "ConnectionError: name or service not known"


def stand_in(folder: Path, name: str, said: Any, code: int = 0) -> None:
    """A program that answers so: a dict on its output, a text on its errors."""
    output, errors = (json.dumps(said), "") if isinstance(said, dict) else ("", str(said))
    lines = ["#!/bin/sh", f"cat <<'END'\n{output}\nEND", f"cat >&2 <<'END'\n{errors}\nEND", f"exit {code}"]
    path = folder / "bin" / name
    path.parent.mkdir(exist_ok=True)
    path.write_text("\n".join(lines) + "\n")
    path.chmod(0o755)


def audited(folder: Path, python: Any, pages: Any) -> tuple[int, str]:
    (folder / "web").mkdir(exist_ok=True)
    stand_in(folder, "pip-audit", python, int(python == FAULTY))
    stand_in(folder, "npm", pages, int(pages != CLEAN_PAGES))
    path = f"{folder / 'bin'}:{os.environ['PATH']}"
    run = subprocess.run([sys.executable, AUDIT], cwd=folder, env={"PATH": path}, capture_output=True, text=True)
    return run.returncode, run.stdout + run.stderr


@pytest.mark.parametrize(
    ("python", "pages", "code", "said"),
    [
        (SOUND, CLEAN_PAGES, 0, "python: 1 packages, no advisory"),
        (FAULTY, CLEAN_PAGES, 1, "numpy 2.4.6: PYSEC-2026-1, fixed in 2.4.7"),
        (SOUND, FAULTY_PAGES, 1, "three: runs what it reads (GHSA-1, high)"),
        (AWAY, CLEAN_PAGES, 75, f"python: NOT AUDITED: {AWAY}"),
        (SOUND, AWAY, 75, f"pages: NOT AUDITED: {AWAY}"),
        (SOUND, {"message": "request to the registry failed"}, 75, "pages: NOT AUDITED: request to the registry"),
        ({"dependencies": []}, CLEAN_PAGES, 75, "pip-audit reported no package"),
        ({"dependencies": [{"name": "x", "skip_reason": "not found"}]}, CLEAN_PAGES, 75, "1 packages were skipped"),
        (AWAY, FAULTY_PAGES, 1, "three: runs what it reads"),
    ],
)
def test_the_verdict_is_what_the_services_said(python: Any, pages: Any, code: int, said: str, tmp_path: Path) -> None:
    found, output = audited(tmp_path, python, pages)
    assert (found, said in output) == (code, True), output


@pytest.mark.parametrize("advisory", ["PYSEC-2026-1", "CVE-2026-1"])
def test_what_is_accepted_for_a_reason_is_no_fault(advisory: str, tmp_path: Path) -> None:
    accepted = tmp_path / "deploy" / "audit-accepted.txt"
    accepted.parent.mkdir()
    accepted.write_text(f"# why\n{advisory} reached by nothing we call\n")
    assert audited(tmp_path, FAULTY, CLEAN_PAGES)[0] == 0
    accepted.write_text(f"{advisory}\n")
    assert "is accepted without a reason" in audited(tmp_path, FAULTY, CLEAN_PAGES)[1]
