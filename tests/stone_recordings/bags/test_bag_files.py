"""Which files are one bag, and what the whole is called by content."""

import subprocess
from hashlib import sha256
from pathlib import Path

import pytest

from stone_files.bag_files import MOST_FILES, BadBagFilesError, check_bag_files, whole_sha256
from stone_files.bag_fingerprint import bag_parts, recording_sha256

SPLIT = [f"run_{number}.mcap" for number in range(3)]


@pytest.mark.parametrize(
    "names",
    [
        ["metadata.yaml", *SPLIT],
        ["run_0.db3", "run_1.db3"],
        ["run_0.db3", "run_0.db3-wal", "metadata.yaml"],
        ["run_0.db3", "run_0.db3-journal"],
        ["run_0.mcap.zstd", "run_1.mcap"],
        ["metadata.yaml", "RUN.MCAP"],
        ["run_0.bag", "run_1.bag.active"],
    ],
)
def test_the_files_of_a_rosbag2_folder_are_one_bag(names: list[str]) -> None:
    check_bag_files(names)


@pytest.mark.parametrize(
    ("names", "why"),
    [
        (["run.mcap"], "these are 1 files"),
        ([f"{number}.mcap" for number in range(MOST_FILES + 1)], f"these are {MOST_FILES + 1} files"),
        (["metadata.yaml", "notes.txt"], "'notes.txt' is not part of a bag"),
        (["metadata.yaml", "metadata.yaml"], "2 files have only 1 names"),
        (["run.mcap", "RUN.mcap"], "2 files have only 1 names"),
        (["run.mcap", "run.db3"], "several kinds are there: .db3, .mcap"),
        (["run_0.db3", "run_1.db3-wal"], "'run_1.db3-wal' has no 'run_1.db3' beside it"),
        (["run_0.mcap", "run_0.db3-wal"], "has no 'run_0.db3' beside it"),
        (["metadata.yaml", "run.db3-wal"], "there is no .mcap, no .db3 and no .bag file"),
        (["Metadata.yaml", "run.mcap"], "'Metadata.yaml' is not part of a bag"),
    ],
)
def test_files_that_cannot_be_one_bag_are_refused_with_the_reason(names: list[str], why: str) -> None:
    with pytest.raises(BadBagFilesError, match=why):
        check_bag_files(names)


def test_the_hash_of_the_whole_is_that_of_what_sha256sum_prints(tmp_path: Path) -> None:
    for name in ("b.mcap", "a.mcap", "metadata.yaml"):
        (tmp_path / name).write_text(name)
    names = ["a.mcap", "b.mcap", "metadata.yaml"]
    printed = subprocess.run(["sha256sum", *names], cwd=tmp_path, capture_output=True, check=True).stdout
    (tmp_path / "notes.txt").write_text("no part of the bag")
    (tmp_path / "a.db3-wal").write_text("")
    assert recording_sha256(tmp_path) == sha256(printed).hexdigest()
    files = [(name, sha256(name.encode()).hexdigest()) for name in reversed(names)]
    assert whole_sha256(files) == recording_sha256(tmp_path)


def test_a_database_and_its_journal_are_one_bag(tmp_path: Path) -> None:
    (tmp_path / "run.db3").write_text("pages")
    alone = recording_sha256(tmp_path / "run.db3")
    (tmp_path / "run.db3-wal").write_text("")
    assert bag_parts(tmp_path / "run.db3") == [tmp_path / "run.db3"]
    (tmp_path / "run.db3-wal").write_text("more pages")
    assert bag_parts(tmp_path / "run.db3") == [tmp_path / "run.db3", tmp_path / "run.db3-wal"]
    assert recording_sha256(tmp_path / "run.db3") != alone
    assert alone == sha256(b"pages").hexdigest()
