"""A version is that of the code and the libraries that make a result: of no folder, date, machine or release."""

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import pytest

from services.labeler.run_workspace import stage_context_of
from services.runtime.code_version import FIXED, KEPT, RELEASE, code_version, digests_in_force, version_of
from services.runtime.jobs.control import cancel
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.orm import Job, LabelSet
from services.runtime.platform import Platform
from services.runtime.source_digests import ENTRIES, ROOTS, SourceDigest, record_of
from testing.refusals import refused_as
from testing.worlds.runs import Brought, Said
from tests.services.domain.sequences.test_processing import ready_on

ROOT = Path(__file__).resolve().parents[3]
OTHER = {kind: SourceDigest("ab" * 32, {"numpy": "1.0"}) for kind in ENTRIES}
VERSIONS = """
import json
from services.runtime.code_version import code_version
from services.runtime.source_digests import ENTRIES
print(json.dumps({kind: code_version(kind) for kind in ENTRIES}))
"""


@dataclass(frozen=True)
class Tree:
    """A copy of the sources that can be changed and run."""

    folder: Path

    def append(self, name: str, line: str) -> None:
        with (self.folder / name).open("a", encoding="utf-8") as file:
            file.write(line)

    def versions(self) -> dict[str, str]:
        """Those that a process tells which runs these sources."""
        command = [sys.executable, "-P", "-c", VERSIONS]
        variables = {**os.environ, "PYTHONPATH": str(self.folder), "PYTHONDONTWRITEBYTECODE": "1"}
        ended = subprocess.run(command, check=True, capture_output=True, env=variables, cwd=self.folder, timeout=120)
        versions: dict[str, str] = json.loads(ended.stdout)
        return versions


@pytest.fixture
def tree(tmp_path: Path) -> Tree:
    folder = tmp_path / "another" / "place"
    for package in ROOTS:
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    return Tree(folder)


def fixed_text(of_kind: object, skipped: int = 0) -> str:
    """A file of digests with the same for each kind but the first ones."""
    return json.dumps({kind: of_kind for kind in list(ENTRIES)[skipped:]})


def here() -> dict[str, str]:
    return {kind: code_version(kind) for kind in ENTRIES}


def test_a_version_covers_code_and_libraries_and_not_the_release() -> None:
    digests = digests_in_force(FIXED, KEPT)
    assert {kind: version_of(one) for kind, one in digests.items()} == here()
    assert RELEASE not in "".join(here().values())
    assert all(re.fullmatch(r"[0-9a-f]{12}", one) for one in here().values())
    assert len(set(here().values())) == len(here())
    labels = digests["labels"]
    installed = {library: version(library) for library in labels.libraries}
    assert {"numpy", "scipy", "numba", "llvmlite"} < installed.keys()
    assert code_version("labels") == version_of(SourceDigest(labels.sha256, installed))


@pytest.mark.parametrize(
    "other", [SourceDigest("b" * 64, {"numpy": "2.4"}), SourceDigest("a" * 64, {"numpy": "2.5"})], ids=["code", "numpy"]
)
def test_other_code_and_another_numpy_are_other_versions(other: SourceDigest) -> None:
    assert version_of(other) != version_of(SourceDigest("a" * 64, {"numpy": "2.4"}))


@pytest.mark.release
def test_equal_sources_in_another_folder_are_of_one_version_and_changed_ones_are_not(tree: Tree) -> None:
    """Catches alone kept digests that survive a change of their source."""
    assert tree.versions() == here()
    kept = tree.folder / "services" / "runtime" / "__pycache__" / KEPT.name
    written = kept.stat().st_mtime_ns
    assert tree.versions() == here()
    assert kept.stat().st_mtime_ns == written
    tree.append("services/labeler/frames.py", "\n\nprint(end='')\n")
    changed = tree.versions()
    assert {kind for kind in ENTRIES if changed[kind] != here()[kind]} == {"labels", "imports"}
    kept.write_text("not JSON")
    assert tree.versions() == changed


def test_what_a_build_fixed_comes_before_the_sources(tmp_path: Path) -> None:
    fixed = tmp_path / "source_digests.json"
    fixed.write_text(json.dumps(record_of(OTHER)))
    assert digests_in_force(fixed, tmp_path / "kept.json") == OTHER


@pytest.mark.parametrize(
    "text",
    [
        "",
        fixed_text("ab" * 32),
        fixed_text({"sha256": "ab" * 32, "libraries": {}}, skipped=1),
        fixed_text({"sha256": "ab" * 31, "libraries": {}}),
        fixed_text({"sha256": "ab" * 32, "libraries": []}),
    ],
)
def test_digests_that_a_build_wrote_wrong_are_refused(text: str, tmp_path: Path) -> None:
    fixed = tmp_path / "source_digests.json"
    fixed.write_text(text)
    with refused_as("broken_digests"):
        digests_in_force(fixed, tmp_path / "kept.json")


def test_labels_of_other_code_are_made_anew_and_its_runs_are_not_gone_on_with(
    platform: Platform, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    brought = ready_on(platform, tmp_path)
    root_id = labelled(brought)
    assert brought.process() == root_id, "the same code has made it already"
    with monkeypatch.context() as other_code:
        other_code.setattr("services.runtime.code_version._DIGESTS", OTHER)
        other_id = brought.process()
    assert other_id != root_id, "other code makes it anew"
    assert brought.job(other_id).arguments["code_version"] == version_of(OTHER["labels"])
    (first,) = brought.jobs(other_id)[1:]
    with pytest.raises(JobCancelledError) as refused:
        stage_context_of(platform, Said(first))
    assert f"{code_version('labels')}" in str(refused.value)
    assert root_id in str(refused.value), "which has made the labels of this code"
    assert brought.job(other_id).state == "cancelled"


def labelled(brought: Brought) -> str:
    """The id of a run that this code has made, which has left its label set."""
    root_id = brought.process()
    with brought.platform.database.transaction() as session:
        recipe = session.get_one(Job, root_id).arguments["recipe"]
        cancel(session, root_id, "")
        row = LabelSet(sequence_id=brought.sequence_id, job_id=root_id, recipe=recipe, parameters={})
        row.code_version, row.frames = code_version("labels"), 1
        session.add(row)
    return root_id
