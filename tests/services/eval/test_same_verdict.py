"""One verdict everywhere: `stone validate`, `stone score` and the server's stages refuse what `validate` refuses.

**Conventions.** The server's is what its stages call (`services/eval/examination.py`), with the ground truth and in the
confined child; codes are compared, and for the command the whole record.

Catches alone a submission that one of the three takes and another refuses.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from typer.main import get_command

from services.eval.examination import Examination, examine
from services.eval.ground_truth import read_truth
from services.eval.truth_pack import write_truth_pack
from services.runtime.sandbox import SandboxWatch
from stone_client.main import app
from stone_files.npz import npz_bytes
from stone_submissions.ground_truth import find_ground_truth
from stone_submissions.manifest import write_manifest
from stone_submissions.validation import validate
from tests.services.eval.attacks import FREE, TOKENS
from tests.services.eval.honest_zips import TOOLS
from tests.services.eval.test_hostile import EVERY_CASE

pytestmark = pytest.mark.whole

Told = Callable[..., tuple[object, dict[str, object]]]
STONE = get_command(app)  # building it anew costs more than a verdict
ATTACKS = {codes: case for case, (codes, _) in EVERY_CASE.items()}.values()  # one of each refusal
HONEST = ("a normal frame", "positional array", "in a folder", "wide end record alone", "sizes behind, 24 bytes",
          "folder in UTF-8", "header of version 2")  # fmt: skip


@dataclass(frozen=True)
class Standing:
    """The ground truth of the attacked manifest: as a folder, as a pack."""

    folder: Path
    manifest: Path
    pack: Path


@pytest.fixture(scope="module")
def standing(tmp_path_factory: pytest.TempPathFactory) -> Standing:
    folder = tmp_path_factory.mktemp("standing")
    for token in TOKENS:
        target = folder / "gts" / "s" / token / "labels.npz"
        target.parent.mkdir(parents=True)
        seen = np.ones_like(FREE)
        target.write_bytes(npz_bytes({"semantics": FREE, "mask_lidar": seen, "mask_camera": seen}))
    truth = find_ground_truth(folder)
    write_manifest(folder / "manifest.json", truth.manifest)
    paths = truth.paths()
    write_truth_pack(folder / "pack", truth.manifest, lambda token: read_truth(paths[token], "all"))
    return Standing(folder, folder / "manifest.json", folder / "pack")


@pytest.fixture
def told(capsys: pytest.CaptureFixture[str]) -> Told:
    """Runs the command; its exit code and JSON."""

    def run(*arguments: str | Path) -> tuple[object, dict[str, object]]:
        with pytest.raises(SystemExit) as ended:
            STONE([*(str(argument) for argument in arguments), "--json"])
        return ended.value.code, json.loads(capsys.readouterr().out)

    return run


@pytest.mark.parametrize("case", ATTACKS)
def test_an_attack_is_refused_alike_everywhere(case: str, standing: Standing, told: Told, tmp_path: Path) -> None:
    path = tmp_path / "sub.zip"
    EVERY_CASE[case][1]()(path)
    verdict = validate(path, standing.manifest)
    assert not verdict.ok
    assert told("validate", path, "--manifest", standing.manifest) == (1, verdict.as_record())
    assert told("score", path, "--ground-truth", standing.folder) == (1, verdict.as_record())
    counted = examine(Examination(path, TOKENS, (0, 2), standing.pack), SandboxWatch())
    assert (counted.validation, counted.counts) == (verdict, None)


@pytest.mark.parametrize("case", HONEST)
def test_an_honest_archive_is_counted_everywhere(case: str, standing: Standing, told: Told, tmp_path: Path) -> None:
    path = tmp_path / "sub.zip"
    TOOLS[case](path)
    assert told("validate", path, "--manifest", standing.manifest) == (0, {"ok": True, "errors": [], "errors_total": 0})
    code, record = told("score", path, "--ground-truth", standing.folder)
    counted = examine(Examination(path, TOKENS, (0, 2), standing.pack), SandboxWatch())
    assert code == 0
    assert counted.counts.confusions.sum(axis=(0, 1)).tolist() == record["confusion"]
