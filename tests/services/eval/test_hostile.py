"""Every hostile submission is refused with its code, within a second and 64 MB; every honest one passes."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from services.eval.manifest import Manifest, write_manifest
from services.eval.pipeline import validate
from tests.services.eval.attacks import HONEST_CASES, HOSTILE_CASES, TOKENS

MOST_SECONDS, MOST_GROWTH_BYTES = 1.0, 64 * 2**20

# Run in a fresh process, whose peak memory nothing else has raised.
CHILD = """
import json, resource, sys, time
from pathlib import Path
from services.eval.pipeline import validate
folder = Path(sys.argv[1])
peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
validate(folder / "honest.zip", folder / "manifest.json")
found, before = {}, peak()
for path in sorted(folder.glob("case*.zip")):
    start = time.process_time()
    verdict = validate(path, folder / "manifest.json")
    found[path.stem] = [verdict.as_record(), time.process_time() - start, peak() - before]
json.dump(found, sys.stdout)
"""


@pytest.fixture(scope="module")
def manifest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("manifest") / "manifest.json"
    write_manifest(path, Manifest({"s": TOKENS}))
    return path


@pytest.mark.parametrize("case", HONEST_CASES)
def test_an_honest_submission_passes(case: str, manifest: Path, tmp_path: Path) -> None:
    HONEST_CASES[case](tmp_path / "sub.zip")
    assert validate(tmp_path / "sub.zip", manifest).as_record() == {"ok": True, "errors": [], "errors_total": 0}


@pytest.fixture(scope="module")
def verdicts(
    manifest: Path, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, tuple[dict[str, object], float, int]]:
    folder = tmp_path_factory.mktemp("hostile")
    (folder / "manifest.json").write_bytes(manifest.read_bytes())
    HONEST_CASES["a normal frame"](folder / "honest.zip")
    for index, (_, make) in enumerate(HOSTILE_CASES.values()):
        make()(folder / f"case{index:02}.zip")
    run = subprocess.run([sys.executable, "-c", CHILD, str(folder)], capture_output=True, check=True, text=True)
    return dict(zip(HOSTILE_CASES, (tuple(value) for _, value in sorted(json.loads(run.stdout).items())), strict=True))


@pytest.mark.parametrize("case", HOSTILE_CASES)
def test_a_hostile_submission_is_refused_fast_and_in_little_memory(
    case: str, verdicts: dict[str, tuple[dict[str, object], float, int]]
) -> None:
    verdict, seconds, growth_bytes = verdicts[case]
    assert verdict["ok"] is False
    errors = verdict["errors"]
    assert isinstance(errors, list)
    assert [error["code"] for error in errors] == [HOSTILE_CASES[case][0]] * len(errors)
    assert seconds <= MOST_SECONDS
    assert growth_bytes <= MOST_GROWTH_BYTES


def test_the_refusal_names_file_frame_expectation_and_finding(manifest: Path, tmp_path: Path) -> None:
    HOSTILE_CASES["int64"][1]()(tmp_path / "sub.zip")
    verdict = validate(tmp_path / "sub.zip", manifest)
    assert [error.as_record() for error in verdict.errors] == [
        {
            "code": "bad_dtype",
            "file": f"{TOKENS[0]}.npz",
            "frame": TOKENS[0],
            "expected": "uint8 ('|u1')",
            "actual": "'<i8'",
        }
    ]
