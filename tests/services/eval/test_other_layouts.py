"""Submissions in layouts that are none: one problem names what the files are, and its line makes a submission of them.

Catches alone a line that participants cannot run, or that makes no valid submission.
"""

import io
import json
import subprocess
import sys
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from stone_client.main import app
from stone_files.npz import npz_bytes
from stone_submissions.errors import hint_of
from stone_submissions.manifest import Manifest, write_manifest
from stone_submissions.validation import validate
from tests.services.eval.attacks import FREE

TOKENS = tuple(f"{number:x}" * 32 for number in (10, 11, 12))
GRID = FREE.copy()
GRID[100:140, 90:130, 9] = 2
FRAME = npz_bytes({"semantics": GRID})
Files = Sequence[tuple[str, bytes]]


def npy() -> bytes:
    content = io.BytesIO()
    np.save(content, GRID)
    return content.getvalue()


def each(name: Callable[[int, str], str], content: bytes = FRAME) -> Files:
    return [(name(number, token), content) for number, token in enumerate(TOKENS)]


def dashed(token: str) -> str:
    return "-".join((token[:8], token[8:12], token[12:16], token[16:20], token[20:]))


FRAMES = each(lambda _, token: f"{token}.npz")
# What was written, the code, and what the problem names.
LAYOUTS: dict[str, tuple[Files, str, str]] = {
    "label layout": (each(lambda _, token: f"gts/field/{token}/labels.npz"), "other_layout", "label layout"),
    "label layout below a folder": (
        each(lambda n, token: f"run/gts/field-{n}/{token}/labels.npz"), "other_layout", "label layout"),
    "a folder per frame": (each(lambda _, token: f"{token}/pred.npz"), "other_layout", "label layout"),
    "backslashes": (each(lambda _, token: f"sub\\{token}.npz"), "other_layout", "names with backslashes"),
    "backslashes in folders": (each(lambda n, token: f"a\\{n}\\{token}.npz"), "other_layout", "names with backslashes"),
    "a folder per scene": (
        each(lambda n, token: f"scene-{n}/{token}.npz"), "other_layout", "each frame in its own folder"
    ),
    "npy": (each(lambda _, token: f"{token}.npy", npy()), "other_layout", ".npy instead of .npz"),
    "npy in a folder": (each(lambda _, token: f"sub/{token}.npy", npy()), "other_layout", ".npy instead of .npz"),
    "capitals": (each(lambda _, token: f"{token.upper()}.npz"), "other_layout", "in upper case or with dashes"),
    "UUIDs": (each(lambda _, token: f"sub/{dashed(token)}.npz"), "other_layout", "in upper case or with dashes"),
    "numbers": (each(lambda n, _: f"{n:06}.npz"), "other_layout", "numbered instead of named by token"),
    "named numbers": (each(lambda n, _: f"run/frame_{n:04}.npz"), "other_layout", "numbered instead of named by token"),
    "resource forks": (
        [*FRAMES, *each(lambda _, token: f"__MACOSX/._{token}.npz", b"fork")], "unexpected_file", "macOS's Finder"),
    "rubbish of two systems": (
        [*FRAMES, (".DS_Store", b"1"), ("Thumbs.db", b"2"), ("._x", b"3")], "unexpected_file", "macOS's Finder"),
    "rubbish below a folder": (
        [*each(lambda _, token: f"sub/{token}.npz"), ("sub/.DS_Store", b"1"), ("__MACOSX/sub/._x.npz", b"3")],
        "unexpected_file", "macOS's Finder"),
}  # fmt: skip
ARRAYS: dict[str, tuple[np.ndarray[Any, Any], str, str]] = {
    "an array named pred": (FREE, "pred", "missing_array"),
    "an array named occ_pred": (FREE, "occ_pred", "missing_array"),
    "classes as int64": (FREE.astype(np.int64), "semantics", "bad_dtype"),
    "classes as floats": (FREE.astype(np.float32), "arr_0", "bad_dtype"),
    "classes as doubles": (FREE.astype(np.float64), "semantics", "bad_dtype"),
    "bools": (FREE.astype(bool), "semantics", "bad_dtype"),
}


def written(folder: Path, files: Files) -> tuple[Path, Path]:
    with zipfile.ZipFile(folder / "sub.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files:
            archive.writestr(name, content)
    write_manifest(folder / "manifest.json", Manifest({"field": TOKENS}))
    return folder / "sub.zip", folder / "manifest.json"


def run_line(hint: str, folder: Path) -> None:
    line = hint.partition("python ")[2]
    subprocess.run(f"{sys.executable} {line}", shell=True, cwd=folder, check=True)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_layout_is_one_problem_whose_line_makes_a_valid_submission(layout: str, tmp_path: Path) -> None:
    files, code, named = LAYOUTS[layout]
    verdict = validate(*written(tmp_path, files))
    (problem,) = verdict.errors
    assert (problem.code, problem.frame, verdict.errors_total) == (code, None, 1)
    assert problem.actual.startswith(("3 ", "2 "))
    assert named in problem.actual
    run_line(hint_of(problem.code, problem.expected, problem.actual), tmp_path)
    mended = validate(tmp_path / "fixed.zip", tmp_path / "manifest.json")
    assert mended.ok, mended.errors


@pytest.mark.parametrize("array", ARRAYS)
def test_arrays_of_another_key_or_dtype_have_the_line_that_saves_them_right(array: str, tmp_path: Path) -> None:
    values, key, code = ARRAYS[array]
    content = io.BytesIO()
    content.write(npz_bytes({key: values}))
    sub, manifest = written(tmp_path, each(lambda _, token: f"{token}.npz", content.getvalue()))
    verdict = validate(sub, manifest)
    assert {problem.code for problem in verdict.errors} == {code}
    said = CliRunner().invoke(app, ["validate", str(sub), "--manifest", str(manifest)])
    lines = [line for line in said.stderr.splitlines() if line.startswith(code)]
    assert len(lines) == 1
    assert "; 2 more files" in lines[0]
    run_line(lines[0].removesuffix(")"), tmp_path)
    assert validate(tmp_path / "fixed.zip", manifest).ok


def test_frames_that_no_layout_explains_are_missing_one_by_one(tmp_path: Path) -> None:
    verdict = validate(*written(tmp_path, [*FRAMES[:1], ("other.npz", FRAME), ("7.npz", FRAME)]))
    assert sorted(problem.code for problem in verdict.errors) == ["missing_frame"] * 2 + ["unexpected_file"] * 2


def test_a_layout_of_some_frames_says_how_many_are_right(tmp_path: Path) -> None:
    files = [*FRAMES[:1], *each(lambda _, token: f"gts/s/{token}/labels.npz")[1:]]
    (problem,) = validate(*written(tmp_path, files)).errors
    assert problem.actual.startswith("2 files in the label layout")
    assert "(1 frame named right)" in problem.actual
    assert json.dumps(problem.as_record())
