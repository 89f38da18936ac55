"""All settings of a process, in one value read from the environment and from secret files.

**Conventions.** A variable is named `STONE_<GROUP>__<NAME>`, for example `STONE_DATABASE__URL`; groups are the nested
dataclasses below. A setting without a variable may be in a secret file of the same name in lower case, such as
`stone_database__password`. Secret files are in `/run/secrets` or the folder `STONE_SECRETS_DIR`; blanks around their
text are dropped. Without any variable the settings are those of the embedded platform: SQLite and a local folder under
`data_folder`. Durations end in `_s`, sizes in `_bytes`. Names of the previous release (`RENAMED`) are accepted for one
more release; if both names are set, the new name applies.

A variable that begins with `STONE_` but is not a setting is refused, and so are impossible values
(`services/runtime/settings_checks.py`). The process then exits at its start with a message about the setting.
"""

import os
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import quote, urlsplit

from pydantic import Field, SecretStr
from pydantic_settings import (
    BaseSettings,
    EnvSettingsSource,
    NestedSecretsSettingsSource,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
)

from services.runtime.in_place.settings import InPlaceSettings
from services.runtime.notification_settings import NotificationSettings
from services.runtime.oidc.settings import OidcSettings
from services.runtime.settings_checks import RENAMED, refuse_impossible, refuse_unknown

GIB = 2**30
SECRETS, SECRETS_VARIABLE = "/run/secrets", "STONE_SECRETS_DIR"


@dataclass(frozen=True)
class DatabaseSettings:
    """The database; if `url` is empty, `stone.sqlite3` in the data folder.

    `password` overrides a password in `url`. At start, a service waits up to `awaited_s` for the schema of its code.
    `pool_size` connections are kept open; it also limits the API's database threads (`database/connections.py`).

    With `api_password` to `eval_password`, all five or none, `prepare` creates a PostgreSQL role for each service
    (`stone_api` to `stone_eval`). Each role owns no table and has only the rights of its service (`database/roles.py`).
    """

    url: str = ""
    password: SecretStr = field(default=SecretStr(""))
    busy_timeout_s: float = 30.0
    pool_size: int = 20
    awaited_s: float = 120.0
    api_password: SecretStr = field(default=SecretStr(""))
    beat_password: SecretStr = field(default=SecretStr(""))
    ingest_password: SecretStr = field(default=SecretStr(""))
    labeler_password: SecretStr = field(default=SecretStr(""))
    eval_password: SecretStr = field(default=SecretStr(""))


@dataclass(frozen=True)
class StoreSettings:
    """The store of blobs: a bucket, or the folder `store` in the data folder if `s3_bucket` is empty.

    The sweeper reads stored bytes at `scrub_bytes_per_s` and compares them with their sha256 (default: 1 TB per month;
    0: never); it reads a bucket only with `scrubs_bucket`. Uploads, the files of jobs, the cache and backups leave
    `reserve_bytes` of the disk free; 0 means the larger of a twentieth of the disk and 2 GiB.
    """

    s3_bucket: str = ""
    s3_endpoint: str = ""
    s3_region: str = "us-east-1"
    s3_key_id: str = ""
    s3_secret: SecretStr = field(default=SecretStr(""))
    cache_bytes: int = 64 * GIB
    grace_s: float = 3600.0
    scrub_bytes_per_s: int = 400_000
    scrubs_bucket: bool = False
    reserve_bytes: Annotated[int, Field(ge=0)] = 0


@dataclass(frozen=True)
class BrokerSettings:
    """The message broker, which only notifies workers; the sweeper sends lost messages again. `password` overrides a
    password in `url`.
    """

    url: str = "redis://127.0.0.1:6379/0"
    password: SecretStr = field(default=SecretStr(""))
    visibility_timeout_s: int = 3600

    @property
    def address(self) -> str:
        """`url` with the password: for connections, never for a log."""
        password = self.password.get_secret_value()
        if not password:
            return self.url
        parts = urlsplit(self.url)
        host = parts.netloc.rpartition("@")[2]
        return parts._replace(netloc=f"{parts.username or ''}:{quote(password, safe='')}@{host}").geturl()


@dataclass(frozen=True)
class JobSettings:
    """Limits of jobs. An attempt without a heartbeat for `lease_s` is lost; a job has `max_attempts` attempts.

    A stopping worker lets its running jobs continue for `drain_s`, then returns them to the queue.
    """

    lease_s: float = 20.0
    heartbeat_s: float = 4.0
    progress_s: float = 0.5
    sweep_s: float = 1.0
    max_attempts: int = 3
    rest_s: float = 2.0
    drain_s: float = 120.0
    time_limit_s: float = 1800.0
    log_lines_per_attempt: int = 5000


@dataclass(frozen=True)
class UploadSettings:
    """Limits of uploads. `owner_bytes` is the maximum of one owner's stored and incoming bytes; a client that sends
    nothing for `idle_s` is disconnected.

    `owner_waiting` is the maximum number of waiting uploads of one owner. An upload waits while it is unfinished, or
    finished but not used yet; the default allows eight bags of 512 files each.

    `backend` is the place of incoming bytes: `folder`, which API and workers share, or `store`, in parts of at most
    `part_bytes`. A change applies to new uploads only; existing uploads stay in place.
    """

    max_bytes: int = 512 * GIB
    owner_bytes: int = 1024 * GIB
    owner_waiting: int = 4096
    expires_s: float = 7 * 86400.0
    form_bytes: int = 64 * 2**20
    idle_s: float = 60.0
    backend: Literal["folder", "store"] = "folder"
    part_bytes: Annotated[int, Field(ge=64 * 2**10, le=64 * 2**20)] = 8 * 2**20


@dataclass(frozen=True)
class SubmissionSettings:
    """Limits of participants' uploads, which are submissions only.

    `participant_bytes` is the maximum of a participant's stored and incoming bytes. `participant_waiting` is the
    maximum number of their waiting uploads, and `draft_waiting` the maximum for one draft. A draft needs only one
    upload; the others are abandoned attempts.

    A draft without any upload is deleted after `draft_s`. The file of a cancelled, invalid or withdrawn submission is
    deleted after `purged_after_s`.
    """

    participant_bytes: int = 60 * GIB
    participant_waiting: int = 400
    draft_waiting: int = 8
    draft_s: float = 7 * 86400.0
    purged_after_s: float = 30 * 86400.0


@dataclass(frozen=True)
class ApiSettings:
    """`url` is the public address of the API for browsers and commands; it also determines whether cookies are
    `Secure`.

    A browser is signed out `session_s` after its sign-in, and `session_idle_s` after its last request.

    With `pages` off the server has no web pages and loads none of their code.

    Clients with `metrics_token` (or one of several, separated by blanks) may read `/metrics`; if it is empty, only
    administrators may.

    `first_password` is the password of the administrator that `prepare` creates if there is none.

    With `passwords` off, sign-in by name and password is disabled. It requires a provider (`oidc`) with a group of
    administrators.

    With `trusts_traceparent` a request's span continues the trace that the request names. Enable it only behind a proxy
    of yours that sets the header itself.

    `trusted_proxies` are the addresses and networks (CIDR) of the proxies in front, separated by blanks or commas. The
    client's address is then the right-most address of `X-Forwarded-For` that is not a proxy, because clients can forge
    the addresses left of it. List only the proxies: rate limits use the client's address. If empty, the header is
    ignored, even from this machine, because any local account could send it.

    A connection has `head_s` for a complete request head. One address (for IPv6 one /64) may have
    `connections_per_address` open connections in a process; trusted proxies may have more.

    A body other than an upload must arrive within `body_s`, plus one second for every `body_bytes_per_s` received. A
    process holds at most `held_body_bytes` of unanswered requests; a user, or an address without a user, may take a
    quarter of it.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    url: str = "http://127.0.0.1:8080"
    pages: bool = True
    head_s: float = 20.0
    connections_per_address: int = 256
    body_bytes: int = 2 * 2**20
    body_s: float = 30.0
    body_bytes_per_s: int = 16 * 2**10
    held_body_bytes: int = 64 * 2**20
    requests_per_minute: int = 1200
    sign_ins_per_minute: int = 10
    session_s: float = 12 * 3600.0
    session_idle_s: float = 30 * 60.0
    token_s: float = 365 * 86400.0
    metrics_token: SecretStr = field(default=SecretStr(""))
    trusts_traceparent: bool = False
    trusted_proxies: str = ""
    first_password: SecretStr = field(default=SecretStr(""))
    passwords: bool = True

    @property
    def proxies(self) -> list[str]:
        """The list of `trusted_proxies`."""
        return self.trusted_proxies.replace(",", " ").split()


@dataclass(frozen=True)
class RetentionSettings:
    """Automatic deletion. Lines of the audit log older than `audit_s` are deleted, and the chain continues from the
    cut; 0 keeps them permanently. Each sequence keeps its newest `label_sets` label sets, and every label set that an
    export, a version, a phase or another user's view requires; 0 keeps all.
    """

    audit_s: Annotated[float, Field(ge=0)] = 0.0
    label_sets: Annotated[int, Field(ge=0)] = 0


@dataclass(frozen=True)
class ViewingSettings:
    """Data for the viewer: with `makes_playback` small images and sweeps are created after labelling."""

    makes_playback: bool = True


@dataclass(frozen=True)
class PublishingSettings:
    """Limits of dataset versions. With `least_held_out_recall` above 0, a version is refused if the held-out recall of
    one of its label sets is lower or unknown."""

    least_held_out_recall: Annotated[float, Field(ge=0, le=1)] = 0.0


def secrets_folder() -> Path:
    """Return the folder of secret files; it may not exist."""
    return Path(os.environ.get(SECRETS_VARIABLE, SECRETS))


class _Environment(EnvSettingsSource):
    """Environment variables, with old and new names."""

    def __call__(self) -> dict[str, Any]:
        return _by_new_names(super().__call__())


class _SecretFiles(NestedSecretsSettingsSource):
    """Secret files, with old and new names."""

    def __call__(self) -> dict[str, Any]:
        return _by_new_names(super().__call__())


class Settings(BaseSettings):
    """The settings of one process; frozen."""

    model_config = SettingsConfigDict(
        env_prefix="STONE_",
        env_nested_delimiter="__",
        frozen=True,
        extra="ignore",
        nested_model_default_partial_update=True,
    )

    data_folder: Path = Path("stone-data")
    workers: int = 0
    database: DatabaseSettings = DatabaseSettings()
    store: StoreSettings = StoreSettings()
    broker: BrokerSettings = BrokerSettings()
    jobs: JobSettings = JobSettings()
    uploads: UploadSettings = UploadSettings()
    in_place: InPlaceSettings = InPlaceSettings()
    submissions: SubmissionSettings = SubmissionSettings()
    api: ApiSettings = ApiSettings()
    oidc: OidcSettings = OidcSettings()
    viewing: ViewingSettings = ViewingSettings()
    retention: RetentionSettings = RetentionSettings()
    publishing: PublishingSettings = PublishingSettings()
    notifications: NotificationSettings = NotificationSettings()

    @classmethod
    def settings_customise_sources(
        cls, settings_cls: type[BaseSettings], *_: PydanticBaseSettingsSource, **sources: PydanticBaseSettingsSource
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Return the sources: first code, then the environment, then secret files. Raises `unknown_setting`."""
        refuse_unknown(cls, os.environ, (path.name for path in secrets_folder().glob("*")))
        known = sources["file_secret_settings"]
        files = _SecretFiles(known, secrets_dir=secrets_folder(), secrets_dir_missing="ok")
        return sources["init_settings"], _Environment(settings_cls), files

    def model_post_init(self, _: Any, /) -> None:
        """Check the values. Raises `impossible_settings`."""
        refuse_impossible(self)

    @cached_property
    def root(self) -> Path:
        """The absolute path of the data folder."""
        return self.data_folder.expanduser().absolute()

    @property
    def database_url(self) -> str:
        return self.database.url or f"sqlite:///{self.root / 'stone.sqlite3'}"

    @property
    def uploads_folder(self) -> Path:
        """Incoming files; shared between the API and the workers that read them (ingest, eval)."""
        return self.root / "uploads"

    @property
    def concurrency(self) -> int:
        """The number of worker processes on this machine: `workers`, or one per available core."""
        return self.workers or len(os.sched_getaffinity(0))


def old_names_in_use() -> list[str]:
    """Return the keys of `RENAMED` that this process's environment or a secret file sets."""
    names = {name.upper() for name in (*os.environ, *(path.name for path in secrets_folder().glob("*")))}
    return [name for name in RENAMED if name in names]


def _by_new_names(groups: dict[str, Any]) -> dict[str, Any]:
    """Return the values of a source with old names replaced by new names, unless the new name is set too."""
    for old, new in RENAMED.items():
        (group, before), (_, after) = (name.removeprefix("STONE_").lower().split("__") for name in (old, new))
        values = groups.get(group)
        if isinstance(values, dict) and before in values:
            values.setdefault(after, values.pop(before))
    return groups
