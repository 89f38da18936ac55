"""The participant's page, line by line: what is printed there is typed here, against a platform with real data."""

import json
import re
import runpy
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from structlog.testing import capture_logs

from services.ingest.stages import open_recording
from services.runtime.access.passwords import hash_password
from services.runtime.benchmarks.inputs import start_inputs
from services.runtime.benchmarks.phases import NewBenchmark, NewPhase, create_benchmark, create_phase
from services.runtime.benchmarks.truths import start_truth
from services.runtime.dataset_reading import dataset_named
from services.runtime.migrate import upgrade
from services.runtime.orm import User
from services.runtime.platform import Platform
from services.runtime.sample_sources import provide_samples
from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from tests.api.published import dataset, published_sequence
from tests.api.serving import person, serving
from tests.benchmark_world import run_eval
from tests.client.participating import answered, scoring, stone
from tests.servers.fixtures import make_settings, opened
from tests.services.runs import bring_ready, run_all

PAGE = Path(__file__).resolve().parents[2] / "docs" / "participant.md"
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PASSWORD = "correct horse battery staple"
RUN = SimulateOptions(seconds=1.5, channels=16, columns=180, cameras=False)
ADDRESS = "http://127.0.0.1:8080"


@dataclass
class Shell:
    """Where the page is typed: commands in this process, so that a line takes no seconds to start."""

    url: str
    printed: list[str]

    def type(self, line: str) -> None:
        words = [word.replace(ADDRESS, self.url) for word in shlex.split(line, comments=True)]
        if words[0] == ".venv/bin/stone":
            result = stone(*words[1:]) if words[1] != "login" else login(words[1:])
            assert result.exit_code == 0, (line, result.stdout, result.stderr, result.exception)
            self.printed.append(result.stdout)
        elif words[0] == ".venv/bin/python":
            before, sys.argv = sys.argv, words[1:]
            runpy.run_path(words[1])
            sys.argv = before
        else:
            subprocess.run(line, shell=True, check=True, timeout=60)


def login(words: list[str]) -> Any:
    from typer.testing import CliRunner

    from client.main import app

    return CliRunner().invoke(app, words, input=f"{PASSWORD}\n")


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Platform]:
    """A platform with two driven and labelled sequences, and a benchmark called `stone` over them."""
    provide_samples(open_recording)
    root = tmp_path_factory.mktemp("field")
    platform = opened(make_settings(root), [])
    upgrade(platform.settings)
    administrator = person(platform, "administrator").user_id
    ids = {"train": [published_sequence(platform, administrator)]}
    for seed, part in enumerate(("val", "test"), start=3):
        bag = root / f"{part}.mcap"
        simulate(bag, SimulateOptions(**{**vars(RUN), "seed": seed}))
        brought = bring_ready(platform, bag, f"n-{part}")
        brought.process()
        ids[part] = [brought.sequence_id]
    run_all(platform)
    _benchmark(platform, administrator, dataset(platform, administrator, ids, "stone-1.0"))
    ada = person(platform, "participant", "ada")
    with platform.database.transaction() as session:
        session.get_one(User, ada.user_id).password_hash = hash_password(PASSWORD)
    yield platform
    platform.database.close()


def _benchmark(platform: Platform, user_id: str, version_name: str) -> None:
    with platform.database.transaction() as session:
        version = dataset_named(session, version_name)
        assert version is not None
        benchmark = create_benchmark(session, NewBenchmark("stone", "STONE", "", user_id))
        for phase in (NewPhase("val", "val", is_hidden=False), NewPhase("test", "test", is_hidden=True)):
            row = create_phase(session, benchmark, version, phase)
            start_truth(session, row, version, user_id)
            start_inputs(session, row, user_id)
    run_eval(platform)
    run_all(platform)


@pytest.mark.slow
def test_the_page_works_line_by_line(field: Platform, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("STONE_URL", "STONE_TOKEN"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("STONE_CONFIG_HOME", str(tmp_path / "configuration"))
    monkeypatch.chdir(tmp_path)
    with serving(field) as url, scoring(field), capture_logs():
        shell, typed = Shell(url, []), 0
        for kind, block in BLOCK.findall(PAGE.read_text("utf-8")):
            if kind == "python":
                Path(block.split()[1].rstrip(":")).write_text(block)
                continue
            for line in block.strip().splitlines():
                shell.type(line)
                typed += 1
        assert typed > 20
        check_what_was_printed(shell)


def check_what_was_printed(shell: Shell) -> None:
    said = "\n".join(shell.printed)
    assert "valid\nvalid\n" in said.replace("\n\n", "\n")
    assert "Sweep (L) in stone / val" in said
    assert Path("board.tex").read_text().count("Sweep") == 1
    listed = answered("results")["submissions"]
    assert [one["method"] for one in listed] == ["Sweep", "Sweep", "Flat"], "the SDK's was the same, not another"
    on_server = answered("results", "latest~1")["total"]
    here = answered("score", "sweep.zip", "--ground-truth", "labels")["total"]
    assert on_server == here
    ranked = answered("leaderboard", "stone", "val", "--all")["rows"]
    assert [row["method"] for row in ranked] == ["Sweep", "Flat"], "geometry beats a plane"
    assert json.loads(Path("val.json").read_text())["sequences"].keys() == {"n-val"}
