"""The administrator's command: what it says, and how it ends."""

import re
from pathlib import Path

import pytest

from services.runtime.backup.__main__ import main
from services.runtime.embedded.folder_lock import hold_folder
from services.runtime.platform import Platform
from tests.services.runtime.backup.laid import Laid, lay, objects_of


@pytest.fixture
def laid(platform: Platform, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Laid:
    monkeypatch.setenv("STONE_DATA_FOLDER", str(platform.settings.root))
    return lay(platform, tmp_path / "scratch")


def test_taken_listed_verified_restored_and_pruned(
    platform: Platform, laid: Laid, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = str(tmp_path / "backups")
    assert main(["to", folder]) == main(["to", folder]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r"backed up \d+ rows and 1 blobs, of which 4 files \(0\.0 MiB\) were new: 2.*Z", first)
    assert "of which 3 files" in second, "work and uploads are read again"
    assert main(["list", folder]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [first.split()[-1], second.split()[-1]]
    assert main(["verify", folder]) == 0
    assert re.match(r"read 4 contents \(0\.0 MiB\) of 2 snapshots", capsys.readouterr().out)
    assert main(["prune", folder, "--keep", "1"]) == 0
    monkeypatch.setenv("STONE_DATA_FOLDER", str(tmp_path / "target"))
    assert main(["restore", folder]) == 0
    said = capsys.readouterr().out
    assert "2 objects and 2 uploads under way; 1 jobs that were running are queued again" in said


def test_refusals_end_with_1_and_say_their_code(
    platform: Platform, laid: Laid, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = str(tmp_path / "backups")
    assert main(["restore", folder]) == 1
    assert capsys.readouterr().err.startswith("snapshot_missing: ")
    assert main(["to", folder]) == 0
    assert main(["restore", folder]) == 1
    assert capsys.readouterr().err.startswith("target_not_empty: the database holds ")


def test_nothing_is_restored_under_a_platform_that_serves(
    platform: Platform, laid: Laid, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["to", str(tmp_path / "backups")]) == 0
    with hold_folder(platform.settings.root):
        assert main(["restore", str(tmp_path / "backups")]) == 1
    assert "already" in capsys.readouterr().err


def test_damage_on_the_platform_ends_with_1_and_the_backup_is_there(
    platform: Platform, laid: Laid, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    key = next(key for key in objects_of(platform) if key.startswith("blobs/"))
    platform.store.delete(key)
    assert main(["to", str(tmp_path / "backups")]) == 1
    assert f"DAMAGED on the platform itself: the store holds no object '{key}'" in capsys.readouterr().err
    assert main(["verify", str(tmp_path / "backups")]) == 0


def test_what_is_asked_for_wrongly_ends_with_2(tmp_path: Path) -> None:
    for words in ([], ["to"], ["prune", str(tmp_path), "--keep", "0"]):
        with pytest.raises(SystemExit) as ended:
            main(words)
        assert ended.value.code == 2
