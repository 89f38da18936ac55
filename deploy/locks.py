"""Generate the lock files of run time, the docs site and each image from requirements.lock, with versions and hashes.

    python deploy/locks.py

**Conventions.** Nothing is resolved and no network is used. Dependencies come from the installed distributions;
versions and hashes come from `requirements.lock`, which also covers tests, docs and audits. So an image and `make
install` contain only tested versions, and the lock files are the same on every machine with the same environment (`make
develop`).
"""

import re
import tomllib
from collections.abc import Iterator, Mapping
from importlib.metadata import requires
from pathlib import Path
from typing import Any

from packaging.markers import Marker, default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
DEPLOY = Path(__file__).parent
RUNTIME = "dependencies"
LOCKS = {
    "runtime.lock": RUNTIME,
    "docs.lock": "docs",
    **{f"images/{role}.lock": f"role-{role}" for role in ("api", "ingest", "labeler", "eval")},
}
HEAD = "# Generated from requirements.lock and {group} of pyproject.toml by deploy/locks.py; do not edit.\n"
PROJECTS = (Path("pyproject.toml"), Path("deploy/client/pyproject.toml"))
OURS = {"stone-client"}
OLDEST = {"python_version": "3.11", "python_full_version": "3.11.0"}
ENTRY = re.compile(r"^([A-Za-z0-9._-]+)==\S+.*\n(?:    --hash=\S+.*\n)+", re.MULTILINE)


def lock_of(group: str) -> str:
    """Return the text of the group's lock, sorted by name. Raises KeyError for a distribution outside the main lock."""
    entries = locked()
    return HEAD.format(group=group) + "".join(entries[name] for name in sorted(needed(group)))


def locked() -> dict[str, str]:
    """Return each distribution's lines in `requirements.lock`, without the comments about its dependants."""
    text = (ROOT / "requirements.lock").read_text("utf-8")
    return {canonicalize_name(match[1]): _unescaped(match[0]) for match in ENTRY.finditer(text)}


def needed(group: str) -> set[str]:
    """Return the group's distributions with all their dependencies here."""
    names: set[str] = set()
    todo = list(asked(group))
    seen: set[tuple[str, frozenset[str]]] = set()
    while todo:
        requirement = todo.pop()
        name, extras = canonicalize_name(requirement.name), frozenset(requirement.extras)
        if (name, extras) not in seen:
            seen.add((name, extras))
            names.add(name)
            todo += _needs(name, extras)
    return names


def asked(group: str) -> list[Requirement]:
    """Return the requirements of the dependency group and its included groups; for `RUNTIME` those of project and
    client.
    """
    projects = [tomllib.loads((ROOT / path).read_text("utf-8")) for path in PROJECTS]
    if group == RUNTIME:
        lines = [line for project in projects for line in project["project"]["dependencies"]]
    else:
        lines = list(_lines(projects[0]["dependency-groups"], group))
    requirements = [Requirement(line) for line in lines]
    return [requirement for requirement in requirements if canonicalize_name(requirement.name) not in OURS]


def _lines(groups: Mapping[str, Any], group: str) -> Iterator[str]:
    for line in groups[group]:
        if isinstance(line, str):
            yield line
        else:
            yield from _lines(groups, line["include-group"])


def _needs(name: str, extras: frozenset[str]) -> Iterator[Requirement]:
    for line in requires(name) or ():
        requirement = Requirement(line)
        if requirement.marker is None or _holds_somewhere(requirement.marker, extras):
            yield requirement


def _holds_somewhere(marker: Marker, extras: frozenset[str]) -> bool:
    """Return whether the marker holds on this Python or the oldest supported one, with any of the extras or none."""
    here: dict[str, str] = {**default_environment(), "extra": ""}  # type: ignore[dict-item]
    wanted = [{**here, "extra": extra, **python} for extra in extras | {""} for python in ({}, OLDEST)]
    return any(marker.evaluate(environment) for environment in wanted)


def _unescaped(lines: str) -> str:
    """Return the entry alone, without a continuation after its last line."""
    return lines.rstrip().rstrip("\\").rstrip() + "\n"


def main() -> None:
    for name, group in LOCKS.items():
        (DEPLOY / name).write_text(lock_of(group), "utf-8")


if __name__ == "__main__":
    main()
