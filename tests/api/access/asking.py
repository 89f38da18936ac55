"""A request for every operation of the document: path, headers and body made of the document's own examples.

**Conventions.** Ids come from a world; what must be one of a kind (names) gets a number. A body that the document
describes without an example (forms, pieces of a file) is made here.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import count
from typing import Any

from testing.api.tus import metadata
from tests.api.access.cast import PASSWORD
from tests.api.access.table import Operation
from tests.api.access.world import CALIBRATION_FILE

NUMBERS = count(1)
INSTEAD = {  # of what is usually named
    "/api/v1/dataset-imports": {"complete_upload": "dataset_upload"},
    "/api/v1/submissions/{submission_id}/finalize": {"complete_upload": "submission_upload"},
    "/api/v1/submissions/{submission_id}/withdraw": {"submission_id": "settled_submission"},
    **{
        f"/api/v1/submissions/{{submission_id}}/{part}": {"submission_id": "scored_submission"}
        for part in (
            "results", "results/breakdowns", "provenance", "confusions", "frames/{token}.png", "predictions.zip",
        )
    },
}  # fmt: skip
IN_BODIES = ("team_id", "upload_id")
ACT_OF = {"queues": "resume", "jobs": "cancel"}
PIECES = "application/offset+octet-stream"
FORM = "multipart/form-data"
HEADERS = {
    "tus-resumable": "1.0.0", "upload-length": "6", "upload-offset": "0",
    "upload-metadata": metadata(filename="rig.yaml", purpose="calibration"), "x-http-method-override": "DELETE",
    "if-match": "*",
}  # fmt: skip


@dataclass(frozen=True)
class Asked:
    """A request without its credential; `ids` are those it names in its path or query, its team and upload."""

    operation: Operation
    path: str
    headers: Mapping[str, str] = field(default_factory=dict)
    content: Mapping[str, Any] = field(default_factory=dict)
    ids: frozenset[str] = frozenset()
    scope: str = ""

    @property
    def is_safe(self) -> bool:
        return self.operation[0] in ("GET", "HEAD", "OPTIONS")


def asked(document: Mapping[str, Any], operation: Operation, named: Mapping[str, str], user_name: str) -> Asked:
    """The request of this operation for the things that are `named`, by the user of that name."""
    method, template = operation
    described = document["paths"][template][method.lower()]
    values = {**named, "act": ACT_OF["queues" if "queues" in template else "jobs"]}
    values |= {key: named[other] for key, other in INSTEAD.get(template, {}).items()}
    ids = {values[name] for name in values if f"{{{name}}}" in template}
    security = described.get("security") or [{"": [""]}]
    scope = next(iter(security[0].values()))[0]
    headers = {"if-match": "*", **_headers(described)}
    content = _content(document, described, values, user_name) | _queries(described, values)
    spoken = [*content.get("params", {}).values(), *(content.get("json", {}).get(one) for one in IN_BODIES)]
    ids |= {value for value in spoken if value in named.values()}
    return Asked(operation, template.format_map(values), headers, content, frozenset(ids), scope)


def _headers(described: Mapping[str, Any]) -> dict[str, str]:
    names = [parameter["name"] for parameter in described.get("parameters", ()) if parameter["in"] == "header"]
    return {name: HEADERS[name.lower()] for name in names if name.lower() in HEADERS}


def _queries(described: Mapping[str, Any], named: Mapping[str, str]) -> dict[str, Any]:
    """What the query must say: an id of the world, or the first of the words that may stand there."""
    asked_for = [one for one in described.get("parameters", ()) if one["in"] == "query" and one.get("required")]
    said = {one["name"]: named.get(one["name"]) or one["schema"]["enum"][0] for one in asked_for}
    return {"params": said} if said else {}


def _content(
    document: Mapping[str, Any], described: Mapping[str, Any], named: Mapping[str, str], user_name: str
) -> dict[str, Any]:
    kinds = described.get("requestBody", {}).get("content", {})
    if "application/json" in kinds:
        schema = kinds["application/json"]["schema"]
        return {"json": _filled(_example(document, schema), named, user_name)}
    if FORM in kinds:
        number = next(NUMBERS)
        file = CALIBRATION_FILE.read_bytes() + f"# {number}\n".encode()
        is_upload = "purpose" in str(kinds[FORM])
        return {"files": {"file": ("rig.yaml", file)}, "data": {"purpose": "calibration"} if is_upload else {}}
    return {"content": b"pieces", "headers": {"Content-Type": PIECES}} if PIECES in kinds else {}


def _example(document: Mapping[str, Any], schema: Mapping[str, Any]) -> dict[str, Any]:
    """The first example of the schema that this one refers to."""
    chosen = next(iter(schema.get("anyOf", [schema])))
    named = document["components"]["schemas"][chosen["$ref"].rpartition("/")[2]]
    found: dict[str, Any] = named["examples"][0]
    return found


def _filled(example: Mapping[str, Any], named: Mapping[str, str], user_name: str) -> dict[str, Any]:
    """The example with ids that exist, names that are free, and the caller's own name and password."""
    if set(example) == {"name", "password"}:
        return {"name": user_name, "password": PASSWORD}
    if set(example) == {"current", "new"}:
        return dict.fromkeys(example, PASSWORD)
    real: dict[str, Any] = {"upload_id": named["complete_upload"], "calibration_id": named["calibration_id"]}
    real |= {"train": [named["sequence_id"]], "dataset": named["dataset_name"], "member": named["member"]}
    real |= {name: named[name] for name in ("phase_id", "truth_id", "team_id", "a_id", "b_id")}
    filled = {key: real.get(key, value) for key, value in example.items()}
    return filled | ({"name": f"{example['name']}-{next(NUMBERS)}"} if "name" in example else {})
