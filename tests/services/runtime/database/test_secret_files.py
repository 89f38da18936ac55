"""Secrets come from files as well as from the environment, and are never shown."""

from pathlib import Path

import pytest
from pydantic_settings import SettingsError

from services.runtime.database.transactions import Database
from services.runtime.settings import SECRETS_VARIABLE, BrokerSettings, Settings


@pytest.fixture
def secrets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "secrets"
    folder.mkdir()
    monkeypatch.setenv(SECRETS_VARIABLE, str(folder))
    monkeypatch.setenv("STONE_DATA_FOLDER", str(tmp_path / "data"))
    return folder


def test_a_file_of_a_settings_name_is_that_setting(secrets: Path) -> None:
    (secrets / "stone_store__s3_secret").write_text("from a file\n")
    (secrets / "STONE_STORE__S3_KEY_ID").write_text("key")
    settings = Settings()
    assert settings.store.s3_secret.get_secret_value() == "from a file"
    assert settings.store.s3_key_id == "key"
    assert settings.store.cache_bytes == Settings.model_fields["store"].default.cache_bytes, "the rest as it was"


def test_the_environment_comes_first_setting_by_setting(secrets: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (secrets / "stone_store__s3_secret").write_text("from a file")
    (secrets / "stone_store__s3_key_id").write_text("key of a file")
    monkeypatch.setenv("STONE_STORE__S3_SECRET", "from the environment")
    settings = Settings()
    assert settings.store.s3_secret.get_secret_value() == "from the environment"
    assert settings.store.s3_key_id == "key of a file"


def test_a_folder_that_is_not_there_holds_no_secrets(secrets: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SECRETS_VARIABLE, str(secrets / "absent"))
    assert Settings().store.s3_secret.get_secret_value() == ""


def test_files_of_others_are_left_alone_and_a_folder_of_them_is_no_fault(secrets: Path) -> None:
    (secrets / "kubernetes.io" / "serviceaccount").mkdir(parents=True)
    (secrets / "kubernetes.io" / "serviceaccount" / "token").write_text("not ours")
    (secrets / "stone").write_text("no setting")
    assert Settings().database.password.get_secret_value() == ""


def test_a_volume_of_secrets_as_a_cluster_mounts_it_is_read(secrets: Path) -> None:
    (secrets / "..2026_11_22").mkdir()
    (secrets / "..2026_11_22" / "stone_database__password").write_text("rotated")
    (secrets / "..data").symlink_to("..2026_11_22")
    (secrets / "stone_database__password").symlink_to("..data/stone_database__password")
    assert Settings().database.password.get_secret_value() == "rotated"


def test_a_folder_of_secrets_that_is_a_file_is_refused(secrets: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (secrets / "file").write_text("")
    monkeypatch.setenv(SECRETS_VARIABLE, str(secrets / "file"))
    with pytest.raises(SettingsError, match="must reference a directory"):
        Settings()


def test_a_database_password_reaches_the_driver_and_no_text(secrets: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (secrets / "stone_database__password").write_text("pass/word@1")
    monkeypatch.setenv("STONE_DATABASE__URL", "postgresql://stone@database/stone")
    settings = Settings()
    engine = Database(settings).engine
    assert engine.url.password == "pass/word@1"
    assert engine.url.host == "database"
    assert "word@1" not in f"{engine} {settings!r} {settings.database_url}"
    engine.dispose()


def test_a_broker_password_is_written_into_its_address_only() -> None:
    broker = BrokerSettings("redis://user@redis:6379/1", password=Settings.model_validate({}).broker.password)
    assert broker.address == "redis://user@redis:6379/1", "without one nothing is added"
    named = Settings.model_validate({"broker": {"url": "redis://redis:6379/1", "password": "p@ss/word"}}).broker
    assert named.address == "redis://:p%40ss%2Fword@redis:6379/1"
    assert "p@ss" not in repr(named)
