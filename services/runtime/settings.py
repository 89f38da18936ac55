"""Everything a process may be told from outside, in one value read from the environment and from secret files.

**Conventions.** `STONE_<GROUP>__<NAME>`, for instance `STONE_DATABASE__URL`; groups are the nested dataclasses below.
What the environment does not say may be a file of the same name in small letters, `stone_database__password`, in
`/run/secrets` or the folder that `STONE_SECRETS_DIR` names; blanks around its text are dropped.
Without any variable the settings are those of the embedded platform: SQLite and a local folder under `data_folder`.
Durations end in `_s`, sizes in `_bytes`. Names of the release before (`RENAMED`) are understood for one release more;
where both names are set, the new one counts.

A variable that begins with `STONE_` and is no setting is refused, and so are values with which a process cannot work
(`services/runtime/settings_checks.py`): it ends as it starts, and says what was meant or needed.
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
    """Where the truth lives; empty: `stone.sqlite3` in the data folder.

    `password` comes before one in `url`. A role that starts waits `awaited_s` for the schema of its code. `pool_size`
    connections are kept open; how many threads of the API may hold one follows from it (`database/connections.py`).

    With `api_password` to `eval_password`, all five or none, `prepare` creates a PostgreSQL role for each service
    (`stone_api` to `stone_eval`), which owns no table and has the rights of its work (`database/roles.py`).
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

    The sweeper reads stored bytes at `scrub_bytes_per_s` and compares them with their sha256 (default: 1 TB a month; 0:
    nothing); it reads a bucket only with `scrubs_bucket`.
    Uploads, the files of jobs, the cache and backups leave `reserve_bytes` of the disk free; 0 means the larger of a
    twentieth of the disk and 2 GiB.
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
    """Carries wake-ups. A message lost here is sent again by the sweeper. `password` comes before one in `url`."""

    url: str = "redis://127.0.0.1:6379/0"
    password: SecretStr = field(default=SecretStr(""))
    visibility_timeout_s: int = 3600

    @property
    def address(self) -> str:
        """`url` with the password in it: for whoever connects, never for a log."""
        password = self.password.get_secret_value()
        if not password:
            return self.url
        parts = urlsplit(self.url)
        place = parts.netloc.rpartition("@")[2]
        return parts._replace(netloc=f"{parts.username or ''}:{quote(password, safe='')}@{place}").geturl()


@dataclass(frozen=True)
class JobSettings:
    """An attempt whose heartbeat stands still for `lease_s` is lost; a job has `max_attempts`.

    A worker that is told to stop gives what it runs `drain_s`, then gives it back.
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
    """Bounds on what comes in. `owner_bytes` is what one owner may have stored or under way; a client that sends
    nothing for `idle_s` is taken for gone.

    `owner_waiting` is how many uploads of one owner may wait at once, which are those that are unfinished, or finished
    and not used yet: eight bags of 512 files each, all of which come before the first is sealed.

    `backend` is where bytes under way lie: `folder`, which API and workers then share, or `store`, in parts of at most
    `part_bytes`. It is of uploads that are created from now on; those under way stay where they are.
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
    """`participant_bytes` is what a participant may have stored or under way, whose uploads are submissions only.

    `participant_waiting` is how many of their uploads may wait at once, `draft_waiting` how many for one draft, which
    needs a single one: the others are tries that were given up.

    A draft for which nothing was sent goes after `draft_s`, the file of a submission that counts for nothing after
    `purged_after_s`.
    """

    participant_bytes: int = 60 * GIB
    participant_waiting: int = 400
    draft_waiting: int = 8
    draft_s: float = 7 * 86400.0
    purged_after_s: float = 30 * 86400.0


@dataclass(frozen=True)
class ApiSettings:
    """`url` is where browsers and commands reach the API; it also decides whether cookies are `Secure`.

    A browser is signed out `session_s` after it signed in, and `session_idle_s` after its last request.

    With `pages` off there are no pages, and nothing of theirs is loaded.

    Whoever shows `metrics_token` (or one of several, between blanks) may read `/metrics`; empty: administrators only.

    `first_password` is the password of the administrator whom `prepare` adds where there is none.

    With `passwords` off nobody signs in by name and password; then there must be a provider (`oidc`), and a group of it
    whose members administer.

    With `trusts_traceparent` a request's span continues the trace that the request names: only behind a proxy of ours
    that sets the header itself.

    `trusted_proxies` are the addresses and networks (CIDR) of the proxies in front, between blanks or commas. Who asks
    is then the right-most address of `X-Forwarded-For` that is not one of them: what stands left of it anybody can
    write. Name the proxies and nothing else: rates and waits are by that address. Empty: the header is ignored, even
    from this machine, because any account on it could send one.

    A connection has `head_s` for a complete request head. One address (of IPv6 one /64) may have
    `connections_per_address` open in a process; trusted proxies may have more.

    A body other than an upload must arrive within `body_s`, and one more second for every `body_bytes_per_s` received.
    A process holds at most `held_body_bytes` of unanswered requests; a user, or an address without a user, may take a
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
        """`trusted_proxies` one by one."""
        return self.trusted_proxies.replace(",", " ").split()


@dataclass(frozen=True)
class RetentionSettings:
    """Automatic deletion. Lines of the audit log older than `audit_s` are deleted, and the chain continues from the
    cut; 0 keeps them for ever. Each sequence keeps its newest `label_sets` label sets, and every label set that an
    export, a version, a phase or another user's view relies on; 0 keeps all."""

    audit_s: Annotated[float, Field(ge=0)] = 0.0
    label_sets: Annotated[int, Field(ge=0)] = 0


@dataclass(frozen=True)
class ViewingSettings:
    """What the viewer is given: with `makes_playback` small pictures and sweeps are made after labels."""

    makes_playback: bool = True


@dataclass(frozen=True)
class PublishingSettings:
    """Limits of dataset versions. With `least_held_out_recall` above 0, a version is refused if the held-out recall of
    one of its label sets is lower or unknown."""

    least_held_out_recall: Annotated[float, Field(ge=0, le=1)] = 0.0


def secrets_folder() -> Path:
    """Where secret files are, if there are any."""
    return Path(os.environ.get(SECRETS_VARIABLE, SECRETS))


class _Environment(EnvSettingsSource):
    """Environment variables, of both names."""

    def __call__(self) -> dict[str, Any]:
        return _by_new_names(super().__call__())


class _SecretFiles(NestedSecretsSettingsSource):
    """Secret files, of both names."""

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
        """First what the code says, then the environment, then secret files. Raises `unknown_setting`."""
        refuse_unknown(cls, os.environ, (path.name for path in secrets_folder().glob("*")))
        known = sources["file_secret_settings"]
        files = _SecretFiles(known, secrets_dir=secrets_folder(), secrets_dir_missing="ok")
        return sources["init_settings"], _Environment(settings_cls), files

    def model_post_init(self, _: Any, /) -> None:
        """Raises `impossible_settings`."""
        refuse_impossible(self)

    @cached_property
    def root(self) -> Path:
        """The data folder, absolute."""
        return self.data_folder.expanduser().absolute()

    @property
    def database_url(self) -> str:
        return self.database.url or f"sqlite:///{self.root / 'stone.sqlite3'}"

    @property
    def uploads_folder(self) -> Path:
        """Files under way; shared between the API and the workers that take them in (ingest, eval)."""
        return self.root / "uploads"

    @property
    def concurrency(self) -> int:
        """Worker processes on this machine: `workers`, or one for every core we may use."""
        return self.workers or len(os.sched_getaffinity(0))


def old_names_in_use() -> list[str]:
    """Keys of `RENAMED` by which the environment or a secret file sets something, of this very process."""
    found = {name.upper() for name in (*os.environ, *(path.name for path in secrets_folder().glob("*")))}
    return [name for name in RENAMED if name in found]


def _by_new_names(groups: dict[str, Any]) -> dict[str, Any]:
    """What a source read, with the values of old names under the new ones unless those are set too."""
    for old, new in RENAMED.items():
        (group, before), (_, after) = (name.removeprefix("STONE_").lower().split("__") for name in (old, new))
        values = groups.get(group)
        if isinstance(values, dict) and before in values:
            values.setdefault(after, values.pop(before))
    return groups
