"""Everything a process may be told from outside, in one value read from the environment.

**Conventions.** `STONE_<GROUP>__<NAME>`, for instance `STONE_DATABASE__URL`; groups are the nested dataclasses below.
Without any variable the settings are those of the embedded platform: SQLite and a local folder under `data_folder`.
Durations end in `_s`, sizes in `_bytes`.
"""

import os
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from pydantic import SecretStr
from pydantic_settings import BaseSettings, SettingsConfigDict

GIB = 2**30


@dataclass(frozen=True)
class DatabaseSettings:
    """Where the truth lives; empty: `stone.sqlite3` in the data folder."""

    url: str = ""
    busy_timeout_s: float = 30.0
    pool_size: int = 20


@dataclass(frozen=True)
class StoreSettings:
    """Where blobs live; an empty `s3_bucket` means the folder `store` in the data folder."""

    s3_bucket: str = ""
    s3_endpoint: str = ""
    s3_region: str = "us-east-1"
    s3_key_id: str = ""
    s3_secret: SecretStr = field(default=SecretStr(""))
    cache_bytes: int = 64 * GIB
    grace_s: float = 3600.0


@dataclass(frozen=True)
class BrokerSettings:
    """The bell. A message lost here is rung again by the sweeper."""

    url: str = "redis://127.0.0.1:6379/0"
    visibility_timeout_s: int = 3600


@dataclass(frozen=True)
class JobSettings:
    """An attempt whose heartbeat stands still for `lease_s` is lost; a job has `max_attempts`."""

    lease_s: float = 20.0
    heartbeat_s: float = 4.0
    progress_s: float = 0.5
    sweep_s: float = 1.0
    max_attempts: int = 3
    rest_s: float = 2.0
    time_limit_s: float = 1800.0
    log_lines_per_attempt: int = 5000


@dataclass(frozen=True)
class UploadSettings:
    """Bounds on what comes in. `owner_bytes` is what one owner may have stored or under way; a client that sends
    nothing for `idle_s` is taken for gone."""

    max_bytes: int = 512 * GIB
    owner_bytes: int = 1024 * GIB
    expires_s: float = 7 * 86400.0
    form_bytes: int = 64 * 2**20
    idle_s: float = 60.0


@dataclass(frozen=True)
class SubmissionSettings:
    """`participant_bytes` is what a participant may have stored or under way, whose uploads are submissions only.

    A draft for which nothing was sent goes after `draft_s`, the file of a submission that counts for nothing after
    `purged_after_s`.
    """

    participant_bytes: int = 60 * GIB
    draft_s: float = 7 * 86400.0
    purged_after_s: float = 30 * 86400.0


@dataclass(frozen=True)
class ApiSettings:
    """`url` is where browsers and commands reach the API; it also decides whether cookies are `Secure`.

    With `pages` off there are no pages, and nothing of theirs is loaded.

    Whoever shows `metrics_token` may read `/metrics`; empty: administrators only.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    url: str = "http://127.0.0.1:8080"
    pages: bool = True
    body_bytes: int = 2 * 2**20
    requests_per_minute: int = 1200
    sign_ins_per_minute: int = 10
    session_s: float = 12 * 3600.0
    token_s: float = 365 * 86400.0
    metrics_token: SecretStr = field(default=SecretStr(""))


@dataclass(frozen=True)
class ViewingSettings:
    """What the viewer is given: with `makes_playback` small pictures and sweeps are made after labels."""

    makes_playback: bool = True


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
    submissions: SubmissionSettings = SubmissionSettings()
    api: ApiSettings = ApiSettings()
    viewing: ViewingSettings = ViewingSettings()

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
