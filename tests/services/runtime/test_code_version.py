"""A version is that of the sources that make a result: of no folder, date or machine, and of no other source."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from services.labeler.stage_context import stage_context_of
from services.runtime.code_version import RELEASE, BrokenDigestsError, code_version, digests_in_force
from services.runtime.jobs.control import cancel
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.orm import Job, LabelSet
from services.runtime.platform import Platform
from services.runtime.source_digests import (
    SOURCES,
    SUFFIXES,
    SourcesMissingError,
    digest_of,
    place_of,
    source_digests,
)
from testing.worlds.runs import Brought, Said
from tests.services.domain.sequences.test_processing import ready_on

ROOT = Path(__file__).resolve().parents[3]
VERSIONS = """
import json
from services.runtime.code_version import code_version
print(json.dumps({kind: code_version(kind) for kind in ("labels", "scores")}))
"""
PROCESS_AGAIN = """
import sys
from services.runtime.orm import SequenceRow
from services.runtime.platform import open_silent_platform
from services.domain.sequences.processing import ProcessRequest, start_processing
from services.runtime.settings import Settings

with open_silent_platform(Settings()).database.transaction() as session:
    print(start_processing(session, session.get_one(SequenceRow, sys.argv[1]), ProcessRequest()).id)
"""


@dataclass(frozen=True)
class Tree:
    """A copy of the sources that can be changed and run."""

    folder: Path

    def append(self, name: str, line: str = "# changed\n") -> None:
        with (self.folder / name).open("a", encoding="utf-8") as file:
            file.write(line)

    def told(self, code: str, *arguments: str, **environment: str) -> str:
        """What a process that runs these sources prints."""
        command = [sys.executable, "-P", "-c", code, *arguments]
        variables = {**os.environ, "PYTHONPATH": str(self.folder), "PYTHONDONTWRITEBYTECODE": "1", **environment}
        outcome = subprocess.run(
            command, check=False, capture_output=True, text=True, env=variables, cwd=self.folder, timeout=120
        )
        assert outcome.returncode == 0, outcome.stderr
        return outcome.stdout.strip()

    def versions(self) -> dict[str, str]:
        versions: dict[str, str] = json.loads(self.told(VERSIONS))
        return versions


@pytest.fixture
def tree(tmp_path: Path) -> Tree:
    folder = tmp_path / "another" / "place"
    for package in ("stone", "stone_base", "stone_files", "stone_recordings", "stone_submissions", "services"):
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    return Tree(folder)


@pytest.fixture
def package(tmp_path: Path) -> Path:
    folder = tmp_path / "package"
    (folder / "deep").mkdir(parents=True)
    (folder / "a.py").write_text("one = 1\n")
    (folder / "deep" / "b.py").write_text("two = 2\n")
    return folder


def here() -> dict[str, str]:
    return {kind: code_version(kind) for kind in SOURCES}


def test_a_version_is_the_release_and_twelve_digits_of_the_digest() -> None:
    assert {kind: f"{RELEASE}+{digest[:12]}" for kind, digest in source_digests().items()} == here()
    assert len({len(digest) for digest in source_digests().values()} | {64}) == 1
    assert code_version("labels") != code_version("scores")


def test_equal_sources_in_another_folder_are_of_one_version(tree: Tree) -> None:
    assert tree.versions() == here()


@pytest.mark.parametrize(
    ("changed", "kinds"),
    [
        ("stone/labels/grid.py", {"labels", "scores"}),
        ("services/labeler/frames.py", {"labels"}),
        ("stone_recordings/sync/synchronisation.py", {"labels"}),
        ("stone_recordings/messages/types/definitions/gps_msgs/msg/GPSFix.msg", {"labels"}),
        ("services/eval/scores.py", {"scores"}),
        ("services/runtime/access/storage_quota.py", set()),
    ],
)
def test_a_changed_source_is_another_version_of_what_it_makes(tree: Tree, changed: str, kinds: set[str]) -> None:
    tree.append(changed)
    before, now = here(), tree.versions()
    assert {kind for kind in SOURCES if now[kind] != before[kind]} == kinds


def test_dates_compiled_files_and_the_order_of_writing_do_not_matter(package: Path, tmp_path: Path) -> None:
    before = digest_of({"package": package})
    again = tmp_path / "again"
    (again / "deep" / "__pycache__").mkdir(parents=True)
    (again / "deep" / "b.py").write_text("two = 2\n")
    (again / "a.py").write_text("one = 1\n")
    (again / "deep" / "__pycache__" / "b.cpython-311.pyc").write_bytes(b"compiled")
    (again / "README.md").write_text("words\n")
    os.utime(again / "a.py", (0, 0))
    assert digest_of({"package": again}) == before


@pytest.mark.parametrize(
    ("was", "is_now"), [("a.py", "c.py"), ("deep/b.py", "b.py")], ids=["renamed", "in another folder"]
)
def test_names_matter(package: Path, was: str, is_now: str) -> None:
    before = digest_of({"package": package})
    (package / was).rename(package / is_now)
    assert digest_of({"package": package}) != before


def test_bytes_that_move_from_one_file_to_the_next_matter(package: Path) -> None:
    before = digest_of({"package": package})
    (package / "a.py").write_text("one = 1")
    (package / "deep" / "b.py").write_text("\ntwo = 2\n")
    assert digest_of({"package": package}) != before


def test_a_single_module_is_a_source_too(package: Path) -> None:
    assert place_of("stone_files.npz") == ROOT / "stone_files" / "npz.py"
    before = digest_of({"a": package / "a.py"})
    (package / "deep" / "b.py").write_text("other\n")
    assert digest_of({"a": package / "a.py"}) == before
    (package / "a.py").write_text("other\n")
    assert digest_of({"a": package / "a.py"}) != before


@pytest.mark.parametrize("name", ["services.nothing", "nothing.at.all", "nothing"])
def test_a_package_that_is_not_there_is_named(name: str) -> None:
    with pytest.raises(SourcesMissingError, match=f"no source file of {name} can be found"):
        place_of(name)


def test_a_package_without_sources_is_named(tmp_path: Path) -> None:
    (tmp_path / "module.pyc").write_bytes(b"compiled")
    with pytest.raises(SourcesMissingError, match="no source file of package"):
        digest_of({"package": tmp_path})


def test_every_file_of_a_source_counts_or_is_words() -> None:
    files = (path for names in SOURCES.values() for name in names for path in place_of(name).rglob("*"))
    suffixes = {path.suffix for path in files if path.is_file() and "__pycache__" not in path.parts}
    assert suffixes - {".md", ".html", ".css"} == SUFFIXES  # documents, and the templates of the quality page


def test_what_a_build_wrote_comes_before_the_sources(tree: Tree) -> None:
    fixed = {"labels": "ab" * 32, "scores": "cd" * 32}
    (tree.folder / "services" / "runtime" / "source_digests.json").write_text(json.dumps(fixed))
    tree.append("stone/labels/grid.py")
    assert tree.versions() == {"labels": f"{RELEASE}+abababababab", "scores": f"{RELEASE}+cdcdcdcdcdcd"}


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "null",
        json.dumps({"labels": "ab" * 32}),
        json.dumps({"labels": "ab" * 32, "scores": "cd" * 31}),
        json.dumps({"labels": "ab" * 32, "scores": 7}),
        json.dumps({"labels": "AB" * 32, "scores": "cd" * 32}),
    ],
)
def test_digests_that_a_build_wrote_wrong_are_refused(text: str, tmp_path: Path) -> None:
    fixed = tmp_path / "source_digests.json"
    fixed.write_text(text)
    with pytest.raises(BrokenDigestsError, match="holds no sha256 for each of labels, scores"):
        digests_in_force(fixed)


def test_labels_of_other_code_are_made_anew_and_its_runs_are_not_gone_on_with(
    platform: Platform, tree: Tree, tmp_path: Path
) -> None:
    brought = ready_on(platform, tmp_path)
    root_id = labelled(brought)
    again = {"STONE_DATA_FOLDER": str(platform.settings.root)}
    assert tree.told(PROCESS_AGAIN, brought.sequence_id, **again) == root_id, "the same code has made it already"
    tree.append("services/labeler/frames.py")
    other_id = tree.told(PROCESS_AGAIN, brought.sequence_id, **again)
    assert other_id != root_id, "other code makes it anew"
    assert brought.job(other_id).arguments["code_version"] == tree.versions()["labels"]
    (first,) = brought.jobs(other_id)[1:]
    with pytest.raises(JobCancelledError) as refused:
        stage_context_of(platform, Said(first))
    assert f"upgraded to code version {code_version('labels')}" in str(refused.value)
    assert f"processed by job {root_id} instead" in str(refused.value), "which has made the labels of this code"
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
