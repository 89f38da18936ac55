"""What an administrator set by a name of the release before is set, and is said to have another name now."""

from pathlib import Path

import pytest
from structlog.testing import capture_logs

from services.runtime.platform import open_platform
from services.runtime.settings import SECRETS_VARIABLE, Settings, UploadSettings, old_names_in_use
from services.runtime.settings_checks import RENAMED, variables_of
from testing.servers.fixtures import make_settings

IN_STORE = UploadSettings(backend="store", part_bytes=2**20)


@pytest.fixture(autouse=True)
def secrets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for secret files, in an environment that sets nothing of uploads."""
    monkeypatch.setenv(SECRETS_VARIABLE, str(tmp_path))
    for name in (*RENAMED, *RENAMED.values(), "STONE_UPLOADS"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


def test_old_names_of_the_environment_are_understood(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STONE_UPLOADS__PLACE", "store")
    monkeypatch.setenv("stone_uploads__slab_bytes", str(2**20))
    assert Settings().uploads == IN_STORE
    assert old_names_in_use() == list(RENAMED)


def test_old_names_of_secret_files_and_of_a_group_in_json_are_understood(
    secrets: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (secrets / "stone_uploads__place").write_text("store\n")
    assert Settings().uploads == UploadSettings(backend="store")
    assert old_names_in_use() == ["STONE_UPLOADS__PLACE"]
    monkeypatch.setenv("STONE_UPLOADS", '{"slab_bytes": 1048576}')
    assert Settings().uploads == IN_STORE


def test_where_both_names_are_set_the_new_one_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STONE_UPLOADS__PLACE", "store")
    monkeypatch.setenv("STONE_UPLOADS__BACKEND", "folder")
    assert Settings().uploads == UploadSettings()


def test_what_an_old_name_sets_is_checked_like_any_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STONE_UPLOADS__SLAB_BYTES", "1")
    with pytest.raises(ValueError, match="part_bytes"):
        Settings()


def test_each_process_says_which_name_to_use(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STONE_UPLOADS__PLACE", "store")
    with capture_logs() as lines:
        open_platform(make_settings(tmp_path)).database.close()
    (line,) = [line for line in lines if "renamed" in line["event"]]
    assert (line["log_level"], line["setting"], line["use"]) == (
        "warning",
        "STONE_UPLOADS__PLACE",
        "STONE_UPLOADS__BACKEND",
    )


def test_a_new_name_is_a_setting_and_an_old_one_is_none() -> None:
    assert set(RENAMED.values()) <= set(variables_of(Settings))
    assert not RENAMED.keys() & set(variables_of(Settings))
