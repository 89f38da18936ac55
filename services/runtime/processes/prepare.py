"""Deployment setup, run once before the processes start: `python -m services.runtime.processes.prepare`.

It creates a missing bucket and upgrades the database to the newest schema. It creates the services' database roles if
their passwords are set, and the first administrator if there is none.

**Conventions.** A second run changes nothing, and concurrent runs are safe. It waits up to `database.awaited_s` for
each service that is not available yet.
"""

import services.runtime.processes.sound_settings  # noqa: F401

# isort: split

import sys

import structlog

from services.runtime.access.users import create_user
from services.runtime.database.migrate import upgrade
from services.runtime.database.roles import ensure_roles
from services.runtime.embedded.first_start import ADMINISTRATOR, find_administrator
from services.runtime.platform import Platform, open_platform
from services.runtime.processes.private_files import keep_private
from services.runtime.processes.startup import insist
from services.runtime.settings import Settings
from services.runtime.telemetry.log_lines import speak_json
from stone.errors import StoneError

log = structlog.get_logger(__name__)


def prepare(settings: Settings) -> None:
    """Run all steps. Raises the errors of `insist`, `upgrade`, `ensure_roles`, `ensure_bucket` and `create_user`."""
    if settings.store.s3_bucket:
        from services.runtime.store.s3 import ensure_bucket

        is_new = insist(lambda: ensure_bucket(settings.store), settings.database.awaited_s)
        log.info("bucket ready", bucket=settings.store.s3_bucket, is_new=is_new)
    insist(lambda: upgrade(settings), settings.database.awaited_s)
    log.info("database schema is that of this version")
    log.info("database roles ready", are_separate=ensure_roles(settings))
    platform = open_platform(settings)
    try:
        log.info("administrator ready", is_new=ensure_administrator(platform))
    finally:
        platform.database.close()


def ensure_administrator(platform: Platform) -> bool:
    """If there is no administrator, create `admin` with `api.first_password`; return whether it was created.

    Without that password create no user. Raises the errors of `create_user`.
    """
    password = platform.settings.api.first_password.get_secret_value()
    with platform.database.transaction() as session:
        if find_administrator(session) is not None:
            return False
        if not password:
            log.warning("there is no administrator, and STONE_API__FIRST_PASSWORD is not set")
            return False
        create_user(session, ADMINISTRATOR, "administrator", password)
        return True


def main() -> None:
    keep_private()
    speak_json()
    try:
        prepare(Settings())
    except StoneError as refusal:
        log.error("not prepared", code=refusal.code, reason=str(refusal))
        sys.exit(1)


if __name__ == "__main__":
    main()
