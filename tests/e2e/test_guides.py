"""The guides, line by line: what is printed there is typed here, against a platform with real data.

Catches alone a line of a guide that does not do what is printed below it.
"""

import json
import os
import shutil
import sys
import tarfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from structlog.testing import capture_logs

from api.client_wheel import ClientWheel
from services.domain.benchmarks.phases.ground_truths import start_truth
from services.domain.benchmarks.phases.inputs import start_inputs
from services.domain.benchmarks.phases.phases import NewBenchmark, NewPhase, create_benchmark, create_phase
from services.domain.datasets.input_jobs import start_version_inputs
from services.domain.datasets.queries import dataset_named
from services.eval.queue_handlers import handlers as eval_handlers
from services.ingest import queue_handlers as ingest
from services.labeler import queue_handlers as labeler
from services.runtime.access.passwords import hash_password
from services.runtime.database.migrate import upgrade
from services.runtime.embedded.first_start import ensure_keys
from services.runtime.in_place.settings import InPlaceSettings
from services.runtime.orm import LabelSet, SequenceRow, User
from services.runtime.platform import Platform
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from stone_client.credentials import remember
from stone_recordings.calibrations.file import read_calibration
from testing.api.serving import person, serving
from testing.servers.fixtures import make_settings, opened
from testing.worlds.benchmark_world import run_eval
from testing.worlds.faults.drive import kitti_drive
from testing.worlds.published import dataset
from testing.worlds.released_datasets import ReleasedDataset, write_released_zip
from testing.worlds.runs import bring_ready, run_all
from tests.deploy.wheels import built_wheel
from tests.e2e.notebooks import NOTEBOOK, kinds, run_cells
from tests.e2e.pasting import ADDRESS, PASSWORD, Shell, blocks, shell_in, statements
from tests.stone_client.participating import answered
from tests.working import working
from web.main import make_site

pytestmark = pytest.mark.whole

RUN = SimulateOptions(seconds=1.5, channels=16, columns=180, cameras=False, lidar_hz=5)
PARTS = {"train": "meadow", "val": "forest", "test": "lake"}
SAID_S = 25.0  # how long the catalogue says that each run lasted: the dataset's rules ask for 20 s
SERVE = ".venv/bin/stone serve"
ADMINISTRATORS_PAGES = tuple(f"operations/{name}.md" for name in ("install", "run", "users", "datasets", "benchmarks"))
INSTALLED_ALONE = "python3 -m venv .venv && "  # the client: tests/deploy/client


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data folder of a platform with an administrator and three driven and labelled sequences; to be copied."""
    root = tmp_path_factory.mktemp("driven")
    platform = opened(make_settings(root), [])
    upgrade(platform.settings)
    ensure_keys(platform)
    for seed, (part, region) in enumerate(PARTS.items(), start=3):
        bag = root / f"{part}.mcap"
        simulate(bag, SimulateOptions(**{**vars(RUN), "seed": seed}))
        brought = bring_ready(platform, bag, f"n-{part}")
        brought.process()
        run_all(platform)
        _say(platform, brought.sequence_id, region)
    platform.database.close()
    return platform.settings.root


@pytest.fixture
def field(driven: Path, tmp_path: Path) -> Iterator[Platform]:
    """A platform of the test's own with those sequences; its folder is also where a guide expects it, and the root
    `here` is where lines are pasted."""
    settings = make_settings(tmp_path, in_place=InPlaceSettings(folders=f"here={tmp_path}"))
    shutil.copytree(driven, settings.root)
    (tmp_path / "stone-data").symlink_to(settings.root)
    platform = opened(settings, [])
    yield platform
    platform.database.close()


def test_the_field_engineers_guide_works_line_by_line(
    field: Platform, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with _pasted(field, tmp_path, monkeypatch, short=True) as shell:
        assert shell.paste("field-engineer.md", elsewhere={SERVE}) > 12
        labels = next(tmp_path.glob("labels/gts/*/*/labels.npz"))
        read_as_printed(shell, "labels", labels.as_posix())
        read_as_printed(shell, "grids", "labels/grid.json")
        for page in ("exports", "datasets"):
            read_as_printed(shell, page, "labels-nuscenes")
    assert {path.name for path in tmp_path.iterdir()} >= {"quality.html", "labels", "labels-nuscenes", "forest.tar"}
    for example in ("my-robot.yaml", "my-robot-ins.yaml", "rig.yaml", "robot.yaml"):
        read_calibration(tmp_path / example)
    here = sorted(path.relative_to(tmp_path) for path in tmp_path.glob("labels/gts/*/*/labels.npz"))
    assert len(here) > 10
    assert json.loads((tmp_path / "labels" / "report.json").read_text())["frames"] == len(here)


def test_a_robot_is_brought_as_its_page_says(field_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kitti_drive(field_data, tmp_path).bag.rename(tmp_path / "K.mcap")
    with shell_in(tmp_path, {}, monkeypatch) as shell:
        assert shell.paste("bring-your-robot.md") == 6
    for labels in ("out", "labels"):
        assert json.loads((tmp_path / labels / "report.json").read_text())["frames"] > 40


def test_the_administrators_guide_works_line_by_line(
    field: Platform, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with _pasted(field, tmp_path, monkeypatch) as shell:
        _drive_of_the_guide(tmp_path)
        assert sum(shell.paste(page, elsewhere=_elsewhere(page)) for page in ADMINISTRATORS_PAGES) > 30
        said = json.loads(shell.printed[-1])
        (ours,) = answered("benchmark", "list", "stone")["benchmarks"]
    assert said["scorings"] == 2
    assert {phase["name"] for phase in ours["phases"]} == {"val", "test", "test-single", "val-lidar"}
    assert json.loads((tmp_path / "manifest.json").read_text())["sequences"]


def test_the_participants_guide_works_line_by_line(
    field: Platform, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _benchmark(field)
    with _pasted(field, tmp_path, monkeypatch) as shell:
        assert shell.paste("participant.md", elsewhere=_elsewhere("participant.md")) > 20
        check_what_was_printed(shell)
        read_as_printed(shell, "submission", "sweep.zip")


@pytest.mark.release
def test_the_participants_guide_works_with_the_wheel_of_the_server_alone(
    field: Platform, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Every line, from the one that installs: in an empty environment, as the participant has it."""
    wheel = built_wheel(Path(__file__).resolve().parents[2] / "deploy" / "client", tmp_path_factory.mktemp("wheel"))
    monkeypatch.setattr("api.main.client_wheel", lambda: ClientWheel(wheel.name, wheel.read_bytes()))
    _benchmark(field)
    typed = {
        "python3 -m venv": f"{sys.executable} -m venv",
        ".venv/bin/stone auth login": f"printf '%s\\n' '{PASSWORD}' | .venv/bin/stone auth login",
        "--name ada": "--name ada --password-stdin",
    }
    with _pasted(field, tmp_path, monkeypatch, typed=typed) as shell:
        assert shell.paste("participant.md") > 20
        check_what_was_printed(shell)
    installed = {path.name for path in (tmp_path / ".venv").glob("lib/python*/site-packages/*")}
    assert not installed & {"stone_local", "numba", "scipy"}


def test_the_page_of_the_sdk_works_line_by_line(
    field: Platform, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with _pasted(field, tmp_path, monkeypatch) as shell:
        _drive_of_the_guide(tmp_path)
        assert shell.paste("sdk.md") == 1
        lines = capsys.readouterr().out.splitlines()
    frames = len(list(tmp_path.glob("sdk-forest-labels/gts/sdk-forest/*/labels.npz")))
    assert lines[0].startswith(f"succeeded ({frames}, 256, 256, 32) uint8 ")
    assert frames > 10
    assert lines[3] == f"sdk-forest.tar {(tmp_path / 'sdk-forest.tar').stat().st_size}"
    assert lines[4].endswith(" nuscenes")
    assert lines[5] == "<1 × LabelSet>"


def test_the_recipes_of_the_api_work_in_bash_and_in_python(
    field: Platform, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ada = person(field, "curator", "ada")
    with field.database.transaction() as session:
        session.get_one(User, ada.user_id).password_hash = hash_password(PASSWORD)
    simulate(tmp_path / "run.mcap", RUN)
    calibration_path(tmp_path / "run.mcap").rename(tmp_path / "robot.yaml")
    names: dict[str, Any] = {}
    with _pasted(field, tmp_path, monkeypatch) as shell:
        for kind, block in blocks("api-cookbook.md"):
            if kind:
                exec(shell.here(block), names)
            else:
                for line in statements(block):
                    shell.type(line)
    lines = capsys.readouterr().out.splitlines()
    assert lines[-2] == "412 precondition_failed"
    assert lines[-1].startswith("404 not_found ")
    assert (tmp_path / "labels.npz").stat().st_size == (tmp_path / "labels-python.npz").stat().st_size
    assert tarfile.is_tarfile(tmp_path / "forest.tar")
    assert tarfile.is_tarfile(tmp_path / "forest-python.tar")


def test_the_notebook_runs_from_top_to_bottom(field: Platform, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And shows what it was stored with: WRITES_GOLDEN=1 stores it."""
    _benchmark(field)
    with field.database.transaction() as session:
        for row in session.query(SequenceRow):
            row.is_public = True
    stored = json.loads(NOTEBOOK.read_text("utf-8"))
    with _pasted(field, tmp_path, monkeypatch):
        shown = run_cells(json.loads(NOTEBOOK.read_text("utf-8")))
    if os.environ.get("WRITES_GOLDEN"):
        NOTEBOOK.write_text(json.dumps(shown, indent=1, ensure_ascii=False) + "\n", "utf-8")
    else:
        assert kinds(shown) == kinds(stored)
    assert "image/png" in {kind for cell in kinds(shown) for kind in cell}


def test_the_release_is_imported_as_its_page_says(
    field: Platform, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The lines before: tests/baselines/test_release_guide.py."""
    twin = ReleasedDataset(frames=2)
    write_released_zip(tmp_path / "STONE.zip", twin)
    page = "use-the-release.md"
    typed = {line for kind, block in blocks(page) if not kind for line in statements(block)}
    with _pasted(field, tmp_path, monkeypatch) as shell:
        assert shell.paste(page, {line for line in typed if " import " not in line}) == 2
    with field.database.reading() as session:
        assert {row.name for row in session.query(SequenceRow)} >= set(twin.tables.names)


def read_as_printed(shell: Shell, page: str, argument: str) -> None:
    """Run the Python program on the page of a format, on a file or folder of that format."""
    (program,) = (block for kind, block in blocks(f"formats/{page}.md") if kind == "python")
    name = program.split()[1]
    Path(name).write_text(program)
    shell.type(f"python {name} {argument}")


def check_what_was_printed(shell: Shell) -> None:
    said = "\n".join(shell.printed)
    assert said.splitlines().count("valid") == 2
    assert "Sweep (L) in stone / val" in said
    assert Path("board.tex").read_text().count("Sweep") == 1
    listed = answered("benchmark", "results")["submissions"]
    assert [one["method"] for one in listed] == ["Sweep", "Sweep", "Flat"], "the SDK's was the same, not another"
    on_server = answered("benchmark", "results", "latest~1")["total"]
    here = answered("score", "sweep.zip", "--ground-truth", "labels")["total"]
    assert on_server == here
    ranked = answered("benchmark", "leaderboard", "stone", "val", "--all")["rows"]
    assert [row["method"] for row in ranked] == ["Sweep", "Flat"], "geometry beats a plane"
    assert json.loads(Path("val.json").read_text())["sequences"].keys() == {"n-val"}
    fetched = sorted(Path("dataset/inputs").rglob("*.tar"))
    assert [path.as_posix() for path in fetched] == ["dataset/inputs/train/n-train.tar", "dataset/inputs/val/n-val.tar"]


@contextmanager
def _pasted(
    platform: Platform,
    folder: Path,
    patch: pytest.MonkeyPatch,
    *,
    short: bool = False,
    typed: Mapping[str, str] | None = None,
) -> Iterator[Shell]:
    """A shell beside the served platform, whose three queues are worked on; `short`: the simulated run is. With words
    that are `typed` for others, every line is bash's, in an environment that the guide makes."""
    queues: dict[str, Any] = {"ingest": ingest.handlers, "labeler": labeler.handlers, "eval": eval_handlers}
    with ExitStack() as stack:
        stack.enter_context(capture_logs())
        url = stack.enter_context(serving(platform, make_site(platform) if typed else None))
        for queue, handlers in queues.items():
            stack.enter_context(working(platform, queue, handlers))
        said = {ADDRESS: url, "31,7,5": "1,1,1", **(typed or {})}
        if short:
            said["simulate run.mcap"] = "simulate run.mcap --seconds 1.5 --channels 16 --columns 180 --camera-width 160"
        shell = stack.enter_context(shell_in(folder, said, patch, is_here=typed is None))
        token = (platform.settings.root / "local-token").read_text().strip()
        remember(url, token, as_default=True)  # as `stone serve` does
        yield shell


def _drive_of_the_guide(folder: Path) -> None:
    """Return the recording whose ceiling the guide measures."""
    bag = folder / "run.mcap"
    simulate(bag, SimulateOptions(4.0, 3, channels=16, columns=180, cameras=False))
    calibration_path(bag).rename(folder / "robot.yaml")


def _elsewhere(page: str) -> set[str]:
    """Lines that other tests run: what installs, and what serves until it is stopped."""
    lines = {line for kind, block in blocks(page) if not kind for line in statements(block)}
    return {line for line in lines if line.startswith(("make ", "apt-get ", "    python3", INSTALLED_ALONE, SERVE))}


def _say(platform: Platform, sequence_id: str, region: str) -> None:
    """Give the sequence what the dataset's rules ask for."""
    with platform.database.transaction() as session:
        row = session.get_one(SequenceRow, sequence_id)
        row.environment, row.illumination, row.region = "mountain", "day", region
        labels = session.query(LabelSet).filter_by(sequence_id=sequence_id).one()
        labels.duration_ns = int(SAID_S * 1e9)


def _benchmark(platform: Platform) -> None:
    """A benchmark called `stone` over a version of all three, and its participant."""
    with platform.database.reading() as session:
        ids = {part: [session.query(SequenceRow).filter_by(name=f"n-{part}").one().id] for part in PARTS}
        user_id = session.query(User).filter_by(role="administrator").one().id
    version_name = dataset(platform, user_id, ids, "stone-1.0")
    with platform.database.transaction() as session:
        version = dataset_named(session, version_name)
        assert version is not None
        benchmark = create_benchmark(session, NewBenchmark("stone", "STONE", "", user_id))
        for phase in (NewPhase("val", "val", is_hidden=False), NewPhase("test", "test", is_hidden=True)):
            row = create_phase(session, benchmark, version, phase)
            start_truth(session, row, version, user_id)
            start_inputs(session, row, user_id)
        start_version_inputs(session, version, user_id)
    run_eval(platform)
    run_all(platform)
    ada = person(platform, "participant", "ada")
    with platform.database.transaction() as session:
        session.get_one(User, ada.user_id).password_hash = hash_password(PASSWORD)
