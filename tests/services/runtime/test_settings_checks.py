"""A setting that nothing reads, or with which nothing works, ends a process as it starts, by name."""

import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from services.runtime.settings import SECRETS_VARIABLE, ApiSettings, JobSettings, Settings
from services.runtime.settings_checks import (
    BOUNDS,
    OTHERS,
    RENAMED,
    ImpossibleSettingsError,
    UnknownSettingError,
    variable_of,
    variables_of,
)

ROOT = Path(__file__).resolve().parents[3]
PROCESSES = (
    "services.runtime.processes.api",
    "services.runtime.processes.prepare",
    "services.runtime.processes.worker",
    "services.maintenance.sweeper",
    "services.runtime.embedded.api_process",
    "services.maintenance.store_check",
    "services.runtime.backup",
)
QUOTED = re.compile(r"""["'](STONE_[A-Z][A-Z0-9_]*[A-Z0-9])["']""")
EXPANDED = re.compile(r"\$\{?(STONE_[A-Z][A-Z0-9_]*[A-Z0-9])")
NO_VARIABLES = {"STONE_MAY_IMPORT"}


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
    with pytest.raises(UnknownSettingError) as refused:
        Settings()
    assert refused.value.code == "unknown_setting"
    assert str(refused.value) == f"{name} is no setting; did you mean {nearest}?"


def test_a_name_like_no_other_is_refused_too_and_all_are_said_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STONE_QQQQQQQQ", "1")
    monkeypatch.setenv("STONE_JOBS__LEASE", "1")
    with pytest.raises(UnknownSettingError, match=r"LEASE_S\?; STONE_QQQQQQQQ is no setting, and none has a name like"):
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
    with pytest.raises(
        UnknownSettingError, match="stone_database__pasword is no setting; did you mean STONE_DATABASE__P"
    ):
        Settings()


def test_every_variable_that_the_project_speaks_of_is_known() -> None:
    """What commands, tests and deployments read may stand in the environment of a process."""
    folders = ("api", "benchmarks", "chaos", "fuzz", "services", "simulator", "stone_client", "testing", "tests", "web")
    modules = [path for folder in folders for path in (ROOT / folder).rglob("*.py") if path != Path(__file__)]
    named = {name for path in modules for name in QUOTED.findall(path.read_text("utf-8"))}
    deployed = [ROOT / "docker-compose.yml", *(ROOT / "deploy").rglob("*.sh"), *(ROOT / "deploy").rglob("Caddyfile")]
    named |= {name for path in deployed for name in EXPANDED.findall(path.read_text("utf-8"))}
    assert {"STONE_TOKEN", "STONE_FIELD_DATA", "STONE_PORTS", "STONE_ENGINE"} <= named
    groups = {variable_of(name) for name in Settings.model_fields}
    assert named - {*variables_of(Settings), *groups, *OTHERS, *RENAMED, *NO_VARIABLES} == set()


def test_every_bound_is_of_a_setting_and_allows_its_default() -> None:
    assert {bound.variable for bound in BOUNDS} <= set(variables_of(Settings))
    Settings()


@pytest.mark.parametrize("bound", BOUNDS, ids=lambda bound: bound.setting)
@pytest.mark.parametrize("by", [0, 1])
def test_a_value_below_its_bound_is_refused_by_name(bound, by: int, monkeypatch: pytest.MonkeyPatch) -> None:
    value = bound.least - by
    monkeypatch.setenv(bound.variable, f"{value:g}")
    if by == 0 and not bound.is_above:
        Settings()
        return
    with pytest.raises(ImpossibleSettingsError, match=f"{bound.variable} is {value:g} and must be") as refused:
        Settings()
    assert bound.otherwise in str(refused.value)


@pytest.mark.parametrize(
    ("told", "sentence"),
    [
        (
            {"STONE_JOBS__HEARTBEAT_S": "6.7"},
            "HEARTBEAT_S is 6.7 and must be less than a third of STONE_JOBS__LEASE_S, 20",
        ),
        ({"STONE_JOBS__LEASE_S": "12"}, "HEARTBEAT_S is 4 and must be less than a third of STONE_JOBS__LEASE_S, 12"),
        ({"STONE_JOBS__HEARTBEAT_S": "nan"}, "STONE_JOBS__HEARTBEAT_S is nan and must be more than 0"),
        ({"STONE_JOBS__LEASE_S": "inf"}, "STONE_JOBS__LEASE_S must be finite"),
        ({"STONE_JOBS__PROGRESS_S": "5"}, "PROGRESS_S is 5 and must not be more than STONE_JOBS__HEARTBEAT_S, 4"),
        ({"STONE_STORE__S3_ENDPOINT": "http://store:8333"}, "STONE_STORE__S3_ENDPOINT needs STONE_STORE__S3_BUCKET"),
        ({"STONE_API__PORT": "65536"}, "STONE_API__PORT is 65536 and must lie from 0 to 65535"),
        ({"STONE_API__URL": "stone.example.org"}, "STONE_API__URL must begin with http:// or https://"),
        ({"STONE_API__URL": "https://"}, "STONE_API__URL must begin with"),
        ({"STONE_API__URL": "http://[::1"}, "STONE_API__URL must begin with"),
        ({"STONE_NOTIFICATIONS__SMTP_HOST": "mail"}, "SMTP_HOST needs STONE_NOTIFICATIONS__SENDER"),
        (
            {"STONE_NOTIFICATIONS__SMTP_HOST": "mail", "STONE_NOTIFICATIONS__SENDER": "stone@x.org\nBcc: eve@x.org"},
            "SMTP_HOST needs STONE_NOTIFICATIONS__SENDER",
        ),
        (
            {"STONE_NOTIFICATIONS__SMTP_USER": "stone", "STONE_NOTIFICATIONS__SMTP_SECURITY": "none"},
            "SMTP_USER needs STARTTLS or TLS",
        ),
        (
            {"STONE_NOTIFICATIONS__WEBHOOK_NETWORKS": "10.1.0.0/16 lab"},
            "WEBHOOK_NETWORKS names 'lab', no network as 10.1.0.0/16 is",
        ),
    ],
)
def test_values_that_contradict_each_other_are_refused(
    told: Mapping[str, str], sentence: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in told.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(ImpossibleSettingsError, match=re.escape(sentence)) as refused:
        Settings()
    assert refused.value.code == "impossible_settings"


def test_what_is_said_in_code_is_checked_alike_and_all_at_once() -> None:
    with pytest.raises(
        ImpossibleSettingsError, match=r"REQUESTS_PER_MINUTE is 0 .* refused; STONE_JOBS__HEARTBEAT_S is 2"
    ):
        Settings(api=ApiSettings(requests_per_minute=0), jobs=JobSettings(lease_s=6.0, heartbeat_s=2.0))


@pytest.mark.parametrize("module", PROCESSES)
def test_every_process_ends_as_it_starts_and_says_why_in_one_line(module: str, tmp_path: Path) -> None:
    outcome = _started(["-m", module], tmp_path, STONE_JOBS__LEASE="30")
    assert outcome.returncode == 1
    (line,) = outcome.stderr.splitlines()
    assert '"code": "unknown_setting"' in line
    assert "did you mean STONE_JOBS__LEASE_S?" in line


def test_a_platform_on_this_machine_is_refused_as_any_input_is(tmp_path: Path) -> None:
    arguments = ["-m", "stone_client.main", "serve", "--data", str(tmp_path / "data")]
    outcome = _started(arguments, tmp_path, STONE_API__REQUESTS_PER_MINUTE="0")
    assert outcome.returncode == 1
    assert outcome.stderr.startswith("impossible_settings: STONE_API__REQUESTS_PER_MINUTE is 0 and must be at least 1")
    assert not (tmp_path / "data").exists()


def _started(arguments: list[str], folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "STONE_DATA_FOLDER": str(folder / "data"), **variables}
    command = [sys.executable, "-P", *arguments]
    return subprocess.run(
        command, check=False, capture_output=True, text=True, env=environment, cwd=folder, timeout=120
    )
