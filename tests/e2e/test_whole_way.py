"""A small simulated world goes the whole way: through the embedded platform, and by the local commands.

Catches alone what breaks between the parts: processes, queue, store and command as a user has them.
"""

import json
import re
import shutil
import subprocess
import sys
import tarfile
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import pytest
from sqlalchemy import select

from chaos.verdict import held_bytes
from services.runtime.access import storage_quota
from services.runtime.orm import User
from services.runtime.platform import open_platform
from services.runtime.settings import Settings
from stone_client.api import Api
from stone_client.credentials import Server
from stone_local.demo.summary import summary_lines
from testing.signals import hear_signals
from testing.stone_serve import environment
from testing.worlds.demo import made_demo, run_small_demo
from testing.worlds.drives import drive

STONE = Path(sys.executable).parent / "stone"
README = Path(__file__).parents[2] / "README.md"
Spoil = Callable[[Path, Path], None]
pytestmark = pytest.mark.whole
REFUSAL = re.compile(r"[A-Za-z]+[-_A-Za-z0-9]*: \S.*")


def stone(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([STONE, *arguments], check=False, capture_output=True, text=True, timeout=300)


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The demo of a smaller robot than the command's; read only."""
    return made_demo(tmp_path_factory) / "demo"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording too short to take long, with its calibration beside it."""
    return drive(tmp_path_factory)


@pytest.mark.release
def test_the_command_ends_with_a_url_that_stays_up_when_asked_to(tmp_path: Path) -> None:
    """Catches alone a demo that ends its platform although it was told to go on serving."""
    options = ("--seconds", "2", "-o", tmp_path / "demo", "--data", tmp_path / "data", "--keep-serving", "--json")
    process = subprocess.Popen(
        [STONE, "demo", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment(tmp_path / "data"),
        preexec_fn=hear_signals,
    )
    try:
        assert process.stdout is not None
        record = json.loads(process.stdout.readline())
        token = (tmp_path / "data" / "local-token").read_text().strip()
        with Api(Server(record["url"], token)) as api:
            (sequence,) = api.pages("/sequences")
        assert (sequence["name"], sequence["labels"]["frames"]) == ("demo", record["labels"]["frames"])
        process.terminate()
        _, said = process.communicate(timeout=300)
        assert process.returncode == 0, said
    finally:
        process.kill()
        process.communicate()


def test_the_demo_leaves_everything_it_promises(demo: Path) -> None:
    names = {entry.name for entry in demo.iterdir()}
    assert names >= {"run.mcap", "truth", "labels", "nuscenes.tar", "manifest.json", "baseline.zip", "demo.json"}
    assert names >= {"dusk", "night", "ground-truth", "inputs", "flat.zip", "sweeps.zip"}
    assert (demo / "labels" / "bev.png").read_bytes().startswith(b"\x89PNG")
    assert not [name for name in names if name.endswith(".partial")]


def test_the_frames_of_the_phase_are_those_of_the_other_two_runs(demo: Path) -> None:
    sequences = json.loads((demo / "manifest.json").read_text())["sequences"]
    for name, tokens in sequences.items():
        files = (demo / "ground-truth" / "gts" / name).glob("*/labels.npz")
        assert {path.parent.name for path in files} == set(tokens)
    assert set(sequences) == {"demo-dusk", "demo-night"}
    assert {path.stem for path in (demo / "inputs").glob("*.tar")} == set(sequences)


def test_the_export_of_the_demo_is_the_release_layout_with_the_same_labels(demo: Path) -> None:
    said = json.loads((demo / "demo.json").read_text())["export"]
    with tarfile.open(demo / "nuscenes.tar") as archive:
        files = {member.name: archive.extractfile(member).read() for member in archive}  # type: ignore[union-attr]
    assert (len(files), (demo / "nuscenes.tar").stat().st_size) == (said["files"], said["size_bytes"])
    for line in files.pop("sha256sum.txt").decode().splitlines():
        digest, _, name = line.partition("  ")
        assert sha256(files[name]).hexdigest() == digest
    for path in demo.glob("labels/gts/demo/*/labels.npz"):
        assert files[path.relative_to(demo / "labels").as_posix()] == path.read_bytes()
    assert len([name for name in files if name.startswith("v1.0-trainval/")]) >= 14


def test_the_baseline_is_scored_between_nothing_and_perfect(demo: Path) -> None:
    score = stone("score", demo / "baseline.zip", "--ground-truth", demo / "ground-truth", "--json")
    assert score.returncode == 0, score.stderr
    record = json.loads(score.stdout)
    assert 0.02 < record["total"]["iou_occ"] < 0.98
    assert record == json.loads((demo / "demo.json").read_text())["baseline"]
    valid = stone("validate", demo / "baseline.zip", "--manifest", demo / "manifest.json")
    assert (valid.returncode, valid.stdout) == (0, "valid\n")


def test_the_board_shows_the_demos_own_entry_with_the_score_that_anybody_gets(demo: Path) -> None:
    record = json.loads((demo / "demo.json").read_text())
    rows = {row["submission_id"]: row for row in record["benchmark"]["board"]["rows"]}
    row = rows[record["benchmark"]["submission"]]
    assert (row["standing"], row["rank"]) == ("baseline", None)
    assert row["ratios"] == record["baseline"]["total"]
    assert row["intervals"]["miou"] == pytest.approx(record["baseline"]["intervals"]["these_places"]["miou"])
    assert sorted(row["standing"] for row in rows.values()) == ["baseline", "baseline", "ranked"]


FIGURES = re.compile(r"\b[0-9a-f]{32}\b|\d+(?:[.,]\d+)*(?: (?:[kMGT]?B|s|min|bytes)\b)?")


def test_the_last_lines_are_those_of_the_readme_and_the_ranked_entry_beats_the_baseline(demo: Path) -> None:
    record = json.loads((demo / "demo.json").read_text())
    lines = summary_lines(record, (Path("demo"), Path("stone-data")), 200.0, stays=True)
    readme = README.read_text("utf-8").replace(".venv/bin/stone", "stone")
    block = next(part for part in readme.split("```") if part.startswith("\n3D view"))
    printed, shown = (FIGURES.sub("#", text).split() for text in ("\n".join(lines), block))
    assert printed == shown
    best = {row["standing"]: row["ratios"]["miou"] for row in reversed(record["benchmark"]["board"]["rows"])}
    assert best["ranked"] > 1.2 * best["baseline"]


def test_no_run_of_the_demo_raises_a_finding_but_of_its_few_rays(demo: Path) -> None:
    for folder in (demo, demo / "dusk", demo / "night"):
        findings = json.loads((folder / "labels" / "report.json").read_text())["findings"]
        assert {finding["code"] for finding in findings} <= {"LAB-607"}


def test_the_quota_of_each_owner_counts_the_bytes_that_the_rows_hold(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path
) -> None:
    data = shutil.copytree(made_demo(tmp_path_factory) / "data", tmp_path / "data")
    platform = open_platform(Settings(data_folder=data))
    with platform.database.reading() as session:
        counted = {user: storage_quota.balance(session, user) for user in session.scalars(select(User.id))}
        held = {user: held_bytes(session, user) for user in counted}
    platform.database.close()
    assert counted == held
    assert max(held.values()) > 2**20


@pytest.mark.release
def test_the_demo_runs_again_on_the_platform_of_the_first(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path
) -> None:
    """Catches alone a step of the demo that refuses what an earlier demo left on the platform."""
    first = made_demo(tmp_path_factory)
    shutil.copytree(first / "data", tmp_path / "data")
    run_small_demo(tmp_path)
    again, before = (json.loads((folder / "demo" / "demo.json").read_text()) for folder in (tmp_path, first))
    assert again["baseline"] == before["baseline"]
    assert again["sequence"] == before["sequence"]


def test_a_second_demo_replaces_the_first_but_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("")
    refused = stone("demo", "-o", tmp_path, "--data", tmp_path / "data")
    assert refused.returncode == 1
    assert refused.stderr.startswith("output_exists: ")
    assert [entry.name for entry in tmp_path.iterdir()] == ["precious"]


def truncated(bag: Path, calibration: Path) -> None:
    bag.write_bytes(bag.read_bytes()[: bag.stat().st_size // 2])


def a_bomb_of_aliases(bag: Path, calibration: Path) -> None:
    rows = "\n".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 12))
    calibration.write_text(f"stone_calibration: 1\na0: &a0 [x]\n{rows}\n")


@pytest.mark.parametrize("spoil", [truncated, a_bomb_of_aliases], ids=lambda f: f.__name__)
def test_a_spoilt_input_is_refused_and_leaves_nothing(spoil: Spoil, recording: Path, tmp_path: Path) -> None:
    bag, calibration = tmp_path / "run.mcap", tmp_path / "rig.yaml"
    bag.write_bytes(recording.read_bytes())
    calibration.write_bytes(recording.with_name("run.calibration.yaml").read_bytes())
    spoil(bag, calibration)
    outcome = stone("label", bag, "--calibration", calibration, "-o", tmp_path / "out", "--json")
    assert outcome.returncode == 1, outcome.stderr
    assert REFUSAL.fullmatch(outcome.stderr.rstrip("\n")), outcome.stderr
    assert json.loads(outcome.stdout)["findings"][0]["severity"] == "error"
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["rig.yaml", "run.mcap"]
