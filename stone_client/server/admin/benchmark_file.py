"""A benchmark described by a file: the differences from the server, and the requests that remove them.

**Conventions.** `benchmark.yaml` has `name`, `dataset`, `title`, `description`, `is_public` and `phases`, each phase by
its name with the fields of the API. Fields and phases that the file leaves out stay as they are on the server. Applying
a file twice changes nothing more. Applying it again completes an interrupted application.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

from stone_base.errors import Refused
from stone_client.api import Api
from stone_client.errors import ServerRefusedError
from stone_client.files.yaml_file import read_yaml
from stone_client.server.sequences import Item

OF_BENCHMARK = ("title", "description", "is_public")
FIXED = ("every_nth",)
OF_PHASE = (
    *("part", "is_hidden", "mask", "every_nth", "dataset", "title", "opens_at", "closes_at", "named_from_at"),
    *("scorings_per_window", "window_s", "scorings_total", "validations_per_day", "team_members"),
)


@dataclass(frozen=True)
class BenchmarkFile:
    """A benchmark from a file: its own fields, and the fields of each phase by name."""

    name: str
    dataset: str
    fields: Mapping[str, Any]
    phases: Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class BenchmarkChange:
    """A request, and the differences that it removes: (field, value on the server, value of the file)."""

    subject: str
    method: str
    path: str
    body: Mapping[str, Any]
    differences: tuple[tuple[str, Any, Any], ...]
    revision: int | None = None

    def as_record(self) -> dict[str, Any]:
        act = "create" if self.method == "POST" else "change"
        fields = [{"field": name, "from": before, "to": after} for name, before, after in self.differences]
        return {"act": act, "subject": self.subject, "fields": fields}


def bad_benchmark_file(path: Path, why: str) -> Refused:
    return Refused("bad_benchmark_file", f"{path} describes no benchmark: {why}")


def read_benchmark_file(path: Path) -> BenchmarkFile:
    """Return the benchmark that the file describes. Raises `bad_yaml`, `bad_benchmark_file`."""
    described = _mapping(path, "the file", read_yaml(path))
    _refuse_unknown(path, "the file", described, ("name", "dataset", "phases", *OF_BENCHMARK))
    name, dataset = (described.get(key) for key in ("name", "dataset"))
    if not isinstance(name, str) or not isinstance(dataset, str):
        raise bad_benchmark_file(path, "`name` and `dataset` are required, each a text")
    phases = _mapping(path, "`phases`", described.get("phases") or {})
    for phase, fields in phases.items():
        _refuse_unknown(path, f"phase {phase}", _mapping(path, f"phase {phase}", fields), OF_PHASE)
        if missing := [key for key in ("part", "is_hidden") if key not in fields]:
            raise bad_benchmark_file(path, f"phase {phase} lacks {' and '.join(missing)}")
    own = {key: described[key] for key in OF_BENCHMARK if key in described}
    return BenchmarkFile(name, dataset, own, phases)


def changes_of(api: Api, wanted: BenchmarkFile) -> list[BenchmarkChange]:
    """Return the ordered requests that make the server match the file; none if it already does."""
    standing = _standing(api, wanted.name)
    return list(_creation(wanted) if standing is None else _changes(wanted, standing))


def phases_beside(api: Api, wanted: BenchmarkFile) -> list[str]:
    """Return the names of phases on the server that the file does not contain; they stay."""
    standing = _standing(api, wanted.name)
    return [phase["name"] for phase in (standing or {"phases": []})["phases"] if phase["name"] not in wanted.phases]


def apply(api: Api, changes: list[BenchmarkChange], reason: str) -> list[str]:
    """Send the requests, and return the findings of phases as sentences. Raises what `Api.send` raises."""
    findings: list[str] = []
    for change in changes:
        match = {} if change.revision is None else {"If-Match": f'"{change.revision}"'}
        answer = api.send(change.method, change.path, json={**change.body, "reason": reason}, headers=match).json()
        for phase in (answer, *answer.get("phases", ())):
            findings += [f"{phase['name']}: {finding['message']}" for finding in phase.get("findings", ())]
    return findings


def _standing(api: Api, name: str) -> Item | None:
    try:
        return api.read(f"/benchmarks/{quote(name, safe='')}")
    except ServerRefusedError as error:
        if error.status != 404:
            raise
        return None


def _creation(wanted: BenchmarkFile) -> Iterator[BenchmarkChange]:
    """Yield one request for the benchmark with its phases, then one for its visibility."""
    settings = {key: value for key, value in wanted.fields.items() if key != "is_public"}
    body = {"name": wanted.name, "dataset": wanted.dataset, **settings}
    if wanted.phases:
        body["phases"] = [{"name": name, **fields} for name, fields in wanted.phases.items()]
    shown = {**body, "phases": list(wanted.phases) or ["val and test, by default"]}
    added = tuple((key, None, value) for key, value in shown.items())
    yield BenchmarkChange(f"benchmark {wanted.name}", "POST", "/admin/benchmarks", body, added)
    if wanted.fields.get("is_public"):
        yield _of_benchmark(wanted, {"is_public": False}, ("is_public",))


def _changes(wanted: BenchmarkFile, standing: Item) -> Iterator[BenchmarkChange]:
    if different := [key for key, value in wanted.fields.items() if standing[key] != value]:
        yield _of_benchmark(wanted, standing, different)
    phases = {item["name"]: item for item in standing["phases"]}
    for name, fields in wanted.phases.items():
        subject, effective = f"phase {name}", {"dataset": wanted.dataset, **fields}
        if name not in phases:
            path = f"/admin/benchmarks/{quote(wanted.name, safe='')}/phases"
            added = tuple((key, None, value) for key, value in effective.items())
            yield BenchmarkChange(subject, "POST", path, {"name": name, **effective}, added)
            continue
        differences = tuple(
            (key, phases[name][key], value)
            for key, value in effective.items()
            if not _is_same(key, phases[name][key], value)
        )
        if fixed := [key for key, _, _ in differences if key in FIXED]:
            raise Refused("phase_fixed", f"{fixed[0]} of phase {name} cannot change; add a phase with another name")
        if differences:
            body = {key: value for key, _, value in differences}
            path, revision = f"/admin/phases/{phases[name]['id']}", phases[name]["revision"]
            yield BenchmarkChange(subject, "PATCH", path, body, differences, revision)


def _of_benchmark(wanted: BenchmarkFile, standing: Item, keys: Any) -> BenchmarkChange:
    body = {key: wanted.fields[key] for key in keys}
    differences = tuple((key, standing[key], value) for key, value in body.items())
    path = f"/admin/benchmarks/{quote(wanted.name, safe='')}"
    return BenchmarkChange(f"benchmark {wanted.name}", "PATCH", path, body, differences)


def _is_same(key: str, standing: Any, wanted: Any) -> bool:
    if key.endswith("_at") and isinstance(standing, str) and isinstance(wanted, str):
        try:
            return _moment(standing) == _moment(wanted)
        except (ValueError, TypeError):
            return False
    return bool(standing == wanted)


def _moment(text: str) -> datetime:
    return datetime.fromisoformat(text.replace("Z", "+00:00"))  # Python 3.10 cannot parse Z


def _mapping(path: Path, what: str, value: Any) -> Mapping[str, Any]:
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise bad_benchmark_file(path, f"{what} is not a mapping of names to values")
    return value


def _refuse_unknown(path: Path, what: str, fields: Mapping[str, Any], known: tuple[str, ...]) -> None:
    if unknown := [key for key in fields if key not in known]:
        raise bad_benchmark_file(path, f"{what} has {unknown[0]!r}; known are {', '.join(known)}")
