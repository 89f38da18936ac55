"""Checks of the settings when a process reads them: unknown names, and impossible values.

**Conventions.** All faults are reported together. A value is quoted only if it is a number or should be an address,
because others may be secrets.
"""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass
from difflib import get_close_matches
from ipaddress import ip_network
from operator import attrgetter
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from services.runtime.in_place.settings import in_place_contradictions
from services.runtime.oidc.settings import provider_contradictions
from stone.errors import Refused

if TYPE_CHECKING:
    from services.runtime.settings import Settings

EMAIL = re.compile(r"[A-Za-z0-9.!#$%&'*+/=?^_`{|}~-]{1,64}@[A-Za-z0-9-]{1,63}(\.[A-Za-z0-9-]{1,63}){0,8}")
"""An e-mail address as in web forms (WHATWG HTML, 4.10.5.1.5), ASCII only, without line ends and blanks."""

PREFIX = "STONE_"
OF_COMMANDS = ("STONE_CONFIG_HOME", "STONE_NO_PROGRESS", "STONE_QUIET", "STONE_TOKEN", "STONE_URL")
OF_DEPLOYMENTS = (
    "STONE_BUILD_OPTIONS",
    "STONE_EDGE_SUBNET",
    "STONE_ENGINE",
    "STONE_EVAL_WORKERS",
    "STONE_INGEST_WORKERS",
    "STONE_LABELER_MEMORY",
    "STONE_LABELER_WORKERS",
    "STONE_PORTS",
    "STONE_PYTHON_IMAGE",
    "STONE_REGISTRY",
    "STONE_SITE",
    "STONE_VERSION",
)
OF_TESTS = (
    "STONE_CHROMIUM",
    "STONE_CRASH_ROUNDS",
    "STONE_CRASH_SEED",
    "STONE_FIELD_DATA",
    "STONE_SCHEMATHESIS_EXAMPLES",
    "STONE_TEST_DROPPED",
)
RENAMED = {"STONE_UPLOADS__PLACE": "STONE_UPLOADS__BACKEND", "STONE_UPLOADS__SLAB_BYTES": "STONE_UPLOADS__PART_BYTES"}
"""New names of variables (and, in small letters, of secret files) by old ones."""
RETIRED = {"FORWARDED_ALLOW_IPS": "STONE_API__TRUSTED_PROXIES"}
"""Removed variables, which would now be ignored, and their replacements."""
OTHERS = frozenset({"STONE_SECRETS_DIR", *OF_COMMANDS, *OF_DEPLOYMENTS, *OF_TESTS})
"""Variables that are not settings of a process but may be in its environment."""


def unknown_setting(names: Sequence[str], known: Iterable[str]) -> Refused:
    meant = {name: [RETIRED[name]] for name in names if name in RETIRED}
    nearest = {name: meant.get(name) or get_close_matches(name.upper(), known, n=1) for name in names}
    return Refused(
        "unknown_setting",
        "; ".join(f"there is no setting {name}{_meant(similar)}" for name, similar in nearest.items()),
    )


@dataclass(frozen=True)
class Bound:
    """The lower bound of a setting, and the consequence of a lower value; `is_above`: the bound itself is excluded."""

    setting: str
    least: float
    otherwise: str
    is_above: bool = False

    @property
    def variable(self) -> str:
        return variable_of(self.setting)

    def allows(self, value: float) -> bool:
        """Return whether the value is within the bound; False for NaN."""
        return value > self.least if self.is_above else value >= self.least


BOUNDS = (
    Bound("workers", 0, "no worker starts (0 is one for every core)"),
    Bound("database.pool_size", 1, "connections are unlimited, or there are none"),
    Bound("store.grace_s", 0, "files are deleted before the row that refers to them is written"),
    Bound("store.scrub_bytes_per_s", 0, "a rate cannot be negative; 0 reads nothing"),
    Bound("broker.visibility_timeout_s", 1, "a message is delivered repeatedly"),
    Bound("jobs.lease_s", 0, "every attempt is lost at its start", is_above=True),
    Bound("jobs.heartbeat_s", 0, "workers only send heartbeats", is_above=True),
    Bound("jobs.progress_s", 0, "workers only report progress", is_above=True),
    Bound("jobs.sweep_s", 0, "the sweeper never pauses", is_above=True),
    Bound("jobs.max_attempts", 1, "no job may be tried"),
    Bound("jobs.rest_s", 0, "the pause is negative"),
    Bound("jobs.drain_s", 0, "a stopping worker never ends"),
    Bound("jobs.time_limit_s", 0, "every attempt exceeds its time at its start", is_above=True),
    Bound("uploads.max_bytes", 1, "every upload is refused"),
    Bound("uploads.owner_bytes", 1, "every upload is refused"),
    Bound("uploads.owner_waiting", 1, "every upload is refused"),
    Bound("uploads.form_bytes", 1, "every form is refused"),
    Bound("uploads.expires_s", 0, "every upload expires at its start", is_above=True),
    Bound("uploads.idle_s", 0, "every sender counts as lost", is_above=True),
    Bound("submissions.participant_bytes", 1, "every submission is refused"),
    Bound("submissions.participant_waiting", 1, "every submission is refused"),
    Bound("submissions.draft_waiting", 1, "every submission is refused"),
    Bound("submissions.draft_s", 0, "the age is negative"),
    Bound("submissions.purged_after_s", 0, "the age is negative"),
    Bound("api.head_s", 0, "every connection is closed immediately", is_above=True),
    Bound("api.connections_per_address", 1, "every connection is refused"),
    Bound("api.body_bytes", 1, "every request with a body is refused"),
    Bound("api.body_s", 0, "every request with a body is refused", is_above=True),
    Bound("api.body_bytes_per_s", 1, "a rate must be positive"),
    Bound("api.requests_per_minute", 1, "every request is refused"),
    Bound("api.sign_ins_per_minute", 1, "no sign-in is possible"),
    Bound("api.session_s", 0, "every user is signed out immediately", is_above=True),
    Bound("api.session_idle_s", 0, "every user is signed out immediately", is_above=True),
    Bound("api.token_s", 0, "every token expires at its creation", is_above=True),
    Bound("oidc.timeout_s", 0, "every request to the provider times out immediately", is_above=True),
)


def variable_of(setting: str) -> str:
    """Return the environment variable of `group.name`."""
    return PREFIX + setting.upper().replace(".", "__")


def variables_of(settings: "type[Settings]") -> Iterator[str]:
    """Yield the name of every environment variable that is a setting."""
    for name, field in settings.model_fields.items():
        if is_dataclass(field.default):
            yield from (variable_of(f"{name}.{setting.name}") for setting in fields(field.default))
        else:
            yield variable_of(name)


def refuse_unknown(settings: "type[Settings]", variables: Iterable[str], files: Iterable[str]) -> None:
    """Raise `unknown_setting` for variables and secret files that look like settings, and for removed settings.

    A group's own name is a setting, with a JSON value. Only files called `stone_<group>__<name>` are considered.
    """
    known = {*variables_of(settings), *(variable_of(name) for name in settings.model_fields)}
    ours = [name for name in files if name.upper().startswith(PREFIX) and "__" in name]
    named = [*(name for name in variables if name.upper().startswith(PREFIX) or name in RETIRED), *ours]
    unknown = sorted(name for name in named if name.upper() not in known | OTHERS | RENAMED.keys())
    if unknown:
        raise unknown_setting(unknown, sorted(known | OTHERS.difference(OF_TESTS)))


def refuse_impossible(settings: "Settings") -> None:
    """Raise `impossible_settings` for values out of bounds and for contradictions."""
    sentences = [*_out_of_bounds(settings), *_contradictions(settings)]
    if sentences:
        raise Refused("impossible_settings", "; ".join(sentences))


def _out_of_bounds(settings: "Settings") -> Iterator[str]:
    for bound in BOUNDS:
        value = attrgetter(bound.setting)(settings)
        if not bound.allows(value):
            needed = f"more than {bound.least:g}" if bound.is_above else f"at least {bound.least:g}"
            yield f"{bound.variable} is {value:g} and must be {needed}: otherwise {bound.otherwise}"


def _contradictions(settings: "Settings") -> Iterator[str]:
    jobs, store, port = settings.jobs, settings.store, settings.api.port
    if not jobs.heartbeat_s < jobs.lease_s / 3:
        yield (
            f"STONE_JOBS__HEARTBEAT_S is {jobs.heartbeat_s:g} and must be less than a third of STONE_JOBS__LEASE_S, "
            f"{jobs.lease_s:g}: otherwise running jobs are considered lost"
        )
    if not jobs.progress_s <= jobs.heartbeat_s:
        yield (
            f"STONE_JOBS__PROGRESS_S is {jobs.progress_s:g} and must not be more than STONE_JOBS__HEARTBEAT_S, "
            f"{jobs.heartbeat_s:g}: a worker sends heartbeats no more often than progress"
        )
    if not math.isfinite(jobs.lease_s):
        yield "STONE_JOBS__LEASE_S must be finite: otherwise jobs of a dead worker are never continued"
    if store.s3_endpoint and not store.s3_bucket:
        yield "STONE_STORE__S3_ENDPOINT requires STONE_STORE__S3_BUCKET: without a bucket the store is a folder"
    if not 0 <= port <= 65535:
        yield f"STONE_API__PORT is {port} and must be between 0 and 65535"
    if settings.api.held_body_bytes < 2 * settings.api.body_bytes:
        yield (
            f"STONE_API__HELD_BODY_BYTES is {settings.api.held_body_bytes} and must be at least twice "
            f"STONE_API__BODY_BYTES, {settings.api.body_bytes}: otherwise the largest body is always refused"
        )
    yield from _untrustworthy(settings.api.proxies)
    yield from provider_contradictions(settings.oidc, settings.api.passwords)
    yield from in_place_contradictions(settings.in_place)
    yield from _unsendable(settings)
    if not _is_address(settings.api.url):
        yield (
            "STONE_API__URL must start with http:// or https:// and contain a host: it decides whether cookies are "
            "Secure"
        )


def _unsendable(settings: "Settings") -> Iterator[str]:
    """Yield the faults of notification settings that prevent sending."""
    notifications = settings.notifications
    if notifications.smtp_host and not EMAIL.fullmatch(notifications.sender):
        yield (
            "STONE_NOTIFICATIONS__SMTP_HOST requires STONE_NOTIFICATIONS__SENDER, an address such as stone@example.org"
        )
    if notifications.smtp_user and notifications.smtp_security == "none":
        yield "STONE_NOTIFICATIONS__SMTP_USER requires STARTTLS or TLS: otherwise the password is sent unencrypted"
    for network in notifications.networks:
        try:
            ip_network(network)
        except ValueError as error:
            yield (
                f"STONE_NOTIFICATIONS__WEBHOOK_NETWORKS has {network[:80]!r}, which is not a network such as "
                f"10.1.0.0/16: {error}"
            )


def _untrustworthy(proxies: Iterable[str]) -> Iterator[str]:
    """Yield the faults of proxies: names that match no address, and networks that trust every client."""
    for proxy in proxies:
        try:
            is_everybody = ip_network(proxy).prefixlen == 0
        except ValueError as error:
            yield (
                f"STONE_API__TRUSTED_PROXIES has {proxy[:80]!r}, which is neither an address nor a network such as "
                f"10.1.0.0/16: {error}"
            )
            continue
        if is_everybody:
            yield (
                f"STONE_API__TRUSTED_PROXIES has {proxy}, with which any client can forge its address; list only the "
                "proxies"
            )


def _is_address(url: str) -> bool:
    try:
        parts = urlsplit(url)
    except ValueError:  # an unclosed bracket
        return False
    return parts.scheme in ("http", "https") and bool(parts.hostname)


def _meant(nearest: list[str]) -> str:
    return f"; did you mean {nearest[0]}?" if nearest else ", and no setting has a similar name"
