"""Every hostile submission is refused with its code, within a second and 64 MB; every honest one passes.

**Conventions.** A case is built, judged and thrown away; what judges is a fresh process (`measuring.py`), one a worker.
"""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from stone_submissions.manifest import Manifest, write_manifest
from stone_submissions.validation import validate
from tests.services.eval.attacks import HOSTILE_CASES, TOKENS, frame, grid, saved
from tests.services.eval.attacks_npy import NPY_CASES
from tests.services.eval.attacks_zip import ZIP_CASES
from tests.services.eval.honest_zips import INFO_ZIP, TOOLS

MOST_CPU_S, MOST_GROWTH_BYTES = 1.0, 64 * 2**20
EVERY_CASE = {**HOSTILE_CASES, **ZIP_CASES, **NPY_CASES}
SOUND = {"ok": True, "errors": [], "errors_total": 0}


@dataclass(frozen=True)
class Judge:
    """What a fresh process says of an archive."""

    manifest: Path
    measured: Callable[[Path], dict[str, Any]]


@pytest.fixture(scope="module")
def judge(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Judge]:
    folder = tmp_path_factory.mktemp("judge")
    manifest, honest = folder / "manifest.json", folder / "honest.zip"
    write_manifest(manifest, Manifest({"s": TOKENS}))
    frame(saved(semantics=grid()))(honest)
    command = [sys.executable, "-m", "tests.services.eval.measuring", str(manifest), str(honest)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1) as process:
        asked, answers = process.stdin, process.stdout

        def measured(path: Path) -> dict[str, Any]:
            asked.write(f"{path}\n")
            found: dict[str, Any] = json.loads(answers.readline())
            return found

        yield Judge(manifest, measured)
        asked.close()


@pytest.mark.parametrize("case", EVERY_CASE)
def test_a_hostile_submission_is_refused_fast_and_in_little_memory(case: str, judge: Judge, tmp_path: Path) -> None:
    codes, make = EVERY_CASE[case]
    make()(tmp_path / "sub.zip")
    found = judge.measured(tmp_path / "sub.zip")
    assert "refused" not in found, found
    verdict = found["verdict"]
    assert verdict["ok"] is False
    assert sorted({error["code"] for error in verdict["errors"]}) == sorted(codes.split())
    assert found["cpu_s"] <= MOST_CPU_S
    assert found["growth_bytes"] <= MOST_GROWTH_BYTES
    for error in verdict["errors"]:
        assert all(len(text) <= 200 and text.isprintable() for text in error.values() if text is not None)


@pytest.mark.parametrize("case", TOOLS)
def test_what_honest_tools_write_passes_within_the_same_limits(case: str, judge: Judge, tmp_path: Path) -> None:
    TOOLS[case](tmp_path / "sub.zip")
    found = judge.measured(tmp_path / "sub.zip")
    assert found.get("verdict") == SOUND, found
    assert found["growth_bytes"] <= MOST_GROWTH_BYTES


@pytest.mark.skipif(shutil.which("zip") is None, reason="Info-ZIP's zip is not installed")
@pytest.mark.parametrize("case", INFO_ZIP)
def test_what_info_zip_writes_passes(case: str, judge: Judge, tmp_path: Path) -> None:
    INFO_ZIP[case](tmp_path / "sub.zip")
    assert judge.measured(tmp_path / "sub.zip").get("verdict") == SOUND


def test_the_refusal_names_file_frame_expectation_and_finding(judge: Judge, tmp_path: Path) -> None:
    HOSTILE_CASES["int64"][1]()(tmp_path / "sub.zip")
    verdict = validate(tmp_path / "sub.zip", judge.manifest)
    assert [error.as_record() for error in verdict.errors] == [
        {
            "code": "bad_dtype",
            "file": f"{TOKENS[0]}.npz",
            "frame": TOKENS[0],
            "expected": "uint8 ('|u1')",
            "actual": "'<i8'",
        }
    ]
