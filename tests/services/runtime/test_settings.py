"""Settings: files of secrets, old names, a provider; what nothing reads, or works with, ends a process as it starts."""

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from pydantic import SecretStr

from services.runtime.database.transactions import Database
from services.runtime.oidc.settings import OidcSettings, groups_in
from services.runtime.settings import (
    SECRETS_VARIABLE,
    ApiSettings,
    BrokerSettings,
    JobSettings,
    Settings,
    UploadSettings,
    old_names_in_use,
)
from services.runtime.settings_checks import BOUNDS, OTHERS, RENAMED
from testing.refusals import refused_as

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(autouse=True)
def _clean(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in os.environ if name.upper().startswith("STONE_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv(SECRETS_VARIABLE, str(tmp_path))


@pytest.mark.parametrize(
    ("name", "nearest"),
    [
        ("STONE_JOBS__LEASE", "STONE_JOBS__LEASE_S"),
        ("STONE_JOBS_LEASE_S", "STONE_JOBS__LEASE_S"),
        ("STONE_DATABASE_URL", "STONE_DATABASE__URL"),
        ("stone_api__prot", "STONE_API__PORT"),
        ("STONE_DATA_FODLER", "STONE_DATA_FOLDER"),
        ("STONE_SECRET_DIR", "STONE_SECRETS_DIR"),
        ("STONE_API__URL__X", "STONE_API__URL"),
    ],
)
def test_a_variable_that_is_no_setting_is_refused_with_the_nearest(
    name: str, nearest: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(name, "a secret")
    with refused_as("unknown_setting", match=f"{name}.* {nearest}") as refused:
        Settings()
    assert refused.value.code == "unknown_setting"
    assert "a secret" not in str(refused.value)


def test_a_name_like_no_other_is_refused_too_and_all_are_said_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STONE_QQQQQQQQ", "1")
    monkeypatch.setenv("STONE_JOBS__LEASE", "1")
    with refused_as("unknown_setting", match=r"LEASE_S\?.*STONE_QQQQQQQQ"):
        Settings()


def test_settings_in_small_letters_whole_groups_and_variables_of_others_are_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("stone_api__port", "81")
    monkeypatch.setenv("STONE_JOBS", '{"max_attempts": 5}')
    for name in OTHERS - {SECRETS_VARIABLE}:
        monkeypatch.setenv(name, "x")
    monkeypatch.setenv("STONEHENGE", "not ours")
    settings = Settings()
    assert (settings.api.port, settings.jobs.max_attempts) == (81, 5)


def test_a_secret_file_that_is_no_setting_is_refused_with_the_nearest(tmp_path: Path) -> None:
    (tmp_path / "stone_database__pasword").write_text("word")
    with refused_as("unknown_setting", match=r"stone_database__pasword.*STONE_DATABASE__P"):
        Settings()


@pytest.mark.parametrize("bound", BOUNDS, ids=lambda bound: bound.setting)
@pytest.mark.parametrize("by", [0, 1])
def test_a_value_below_its_bound_is_refused_by_name(bound, by: int, monkeypatch: pytest.MonkeyPatch) -> None:
    value = bound.least - by
    monkeypatch.setenv(bound.variable, f"{value:g}")
    if by == 0 and not bound.is_above:
        Settings()
        return
    with refused_as("impossible_settings", match=f"{bound.variable} is {value:g} "):
        Settings()


@pytest.mark.parametrize(
    "told",
    [
        {"STONE_JOBS__HEARTBEAT_S": "6.7"},
        {"STONE_JOBS__LEASE_S": "12"},
        {"STONE_JOBS__HEARTBEAT_S": "nan"},
        {"STONE_JOBS__LEASE_S": "inf"},
        {"STONE_API__HELD_BODY_BYTES": "4000000"},
        {"STONE_JOBS__PROGRESS_S": "5"},
        {"STONE_STORE__S3_ENDPOINT": "http://store:8333"},
        {"STONE_API__PORT": "65536"},
        *({"STONE_API__URL": url} for url in ("stone.example.org", "https://", "http://[::1")),
        {"STONE_NOTIFICATIONS__SMTP_HOST": "mail"},
        {"STONE_NOTIFICATIONS__SMTP_HOST": "mail", "STONE_NOTIFICATIONS__SENDER": "stone@x.org\nBcc: eve@x.org"},
        {"STONE_NOTIFICATIONS__SMTP_USER": "stone", "STONE_NOTIFICATIONS__SMTP_SECURITY": "none"},
        {"STONE_NOTIFICATIONS__WEBHOOK_NETWORKS": "10.1.0.0/16 lab"},
        *(
            {"STONE_API__TRUSTED_PROXIES": named}
            for named in ("*", "proxy", "10.1.2.3/16", "0.0.0.0/0", "10.0.0.0/8,::/0")
        ),
    ],
)
def test_values_that_contradict_each_other_are_refused(
    told: Mapping[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in told.items():
        monkeypatch.setenv(name, value)
    with refused_as("impossible_settings") as refused:
        Settings()
    assert refused.value.code == "impossible_settings"


def test_what_is_said_in_code_is_checked_alike_and_all_at_once() -> None:
    with refused_as("impossible_settings", match=r"REQUESTS_PER_MINUTE is 0 .*HEARTBEAT_S is 2"):
        Settings(api=ApiSettings(requests_per_minute=0), jobs=JobSettings(lease_s=6.0, heartbeat_s=2.0))


@pytest.mark.whole
def test_a_process_ends_as_it_starts_and_says_why_in_one_line(tmp_path: Path) -> None:
    outcome = _started(["-m", "services.runtime.processes.api"], tmp_path, STONE_JOBS__LEASE="30")
    assert outcome.returncode == 1
    (line,) = outcome.stderr.splitlines()
    assert '"code": "unknown_setting"' in line
    assert "did you mean STONE_JOBS__LEASE_S?" in line


@pytest.mark.whole
def test_a_platform_on_this_machine_is_refused_as_any_input_is(tmp_path: Path) -> None:
    arguments = ["-m", "stone_client.main", "serve", "--data", str(tmp_path / "data")]
    outcome = _started(arguments, tmp_path, STONE_API__REQUESTS_PER_MINUTE="0")
    assert outcome.returncode == 1
    assert outcome.stderr.startswith("impossible_settings: STONE_API__REQUESTS_PER_MINUTE is 0 ")
    assert not (tmp_path / "data").exists()


def _started(arguments: list[str], folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "STONE_DATA_FOLDER": str(folder / "data"), **variables}
    command = [sys.executable, "-P", *arguments]
    return subprocess.run(
        command, check=False, capture_output=True, text=True, env=environment, cwd=folder, timeout=120
    )


IN_STORE = UploadSettings(backend="store", part_bytes=2**20)


def test_old_names_of_the_environment_are_understood(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STONE_UPLOADS__PLACE", "store")
    monkeypatch.setenv("stone_uploads__slab_bytes", str(2**20))
    assert Settings().uploads == IN_STORE
    assert old_names_in_use() == list(RENAMED)


def test_old_names_of_secret_files_and_of_a_group_in_json_are_understood(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "stone_uploads__place").write_text("store\n")
    assert Settings().uploads == UploadSettings(backend="store")
    assert old_names_in_use() == ["STONE_UPLOADS__PLACE"]
    monkeypatch.setenv("STONE_UPLOADS", '{"slab_bytes": 1048576}')
    assert Settings().uploads == IN_STORE


def test_where_both_names_are_set_the_new_one_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STONE_UPLOADS__PLACE", "store")
    monkeypatch.setenv("STONE_UPLOADS__BACKEND", "folder")
    assert Settings().uploads == UploadSettings()


@pytest.fixture
def secrets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "secrets"
    folder.mkdir()
    monkeypatch.setenv(SECRETS_VARIABLE, str(folder))
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


LAB = {"issuer": "https://id.lab.example/realms/lab", "client_id": "stone"}


def provided(is_by_password: bool = True, **oidc: Any) -> Settings:
    return Settings(api=ApiSettings(passwords=is_by_password), oidc=OidcSettings(**oidc))


@pytest.mark.parametrize("oidc", [{}, LAB, LAB | {"administrators": " , "}])
def test_passwords_are_not_switched_off_where_nobody_could_administer_then(oidc: dict[str, Any]) -> None:
    with refused_as("impossible_settings"):
        provided(is_by_password=False, **oidc)


def test_passwords_are_switched_off_where_a_group_administers() -> None:
    assert not provided(is_by_password=False, **LAB, administrators="stone-admins").api.passwords


@pytest.mark.parametrize(
    "issuer",
    [
        "http://id.lab.example",
        "id.lab.example",
        "https://",
        "https://ada:secret@id.lab.example",
        "https://id.lab.example/?realm=lab",
        "https://id.lab.example/#lab",
        "https://id.lab.example/a b",
        "https://id.lab.example:port",
        "file:///etc/passwd",
        "https://id.lab.example/" + "a" * 500,
    ],
)
def test_an_issuer_that_is_no_safe_address_is_refused(issuer: str) -> None:
    with refused_as("impossible_settings", match="STONE_OIDC__ISSUER"):
        provided(issuer=issuer, client_id="stone")


@pytest.mark.parametrize(
    "issuer", ["https://id.lab.example/", "http://127.0.0.1:9400", "http://localhost:8081/realms/x"]
)
def test_an_issuer_is_https_or_on_this_machine(issuer: str) -> None:
    assert provided(issuer=issuer, client_id="stone").oidc.issuer == issuer


@pytest.mark.parametrize(
    "oidc",
    [
        {"issuer": LAB["issuer"]},
        {"client_id": "stone"},
        {"client_secret": SecretStr("hidden")},
        LAB | {"scopes": "profile email"},
    ],
)
def test_half_a_provider_is_refused(oidc: dict[str, Any]) -> None:
    with refused_as("impossible_settings") as refusal:
        provided(**oidc)
    assert "hidden" not in str(refusal.value)


def test_the_example_of_the_administrators_guide_is_a_provider(monkeypatch: pytest.MonkeyPatch) -> None:
    guide = (ROOT / "docs" / "operations" / "users.md").read_text("utf-8")
    (block,) = re.findall(r"```sh\n# lab\.env[^\n]*\n(.*?)```", guide, re.DOTALL)
    for line in shlex.split(block):
        monkeypatch.setenv(*line.split("=", 1))
    settings = Settings()
    assert settings.oidc.shown_title == "Field Robotics Lab"
    assert groups_in(settings.oidc.participants) == {"students", "guests"}
