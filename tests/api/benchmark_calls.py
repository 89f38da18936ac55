"""Calls by which tests of benchmarks make and change them."""

from collections.abc import Mapping
from typing import Any

import httpx

from testing.api.serving import Person

V1 = "/api/v1"
ADMIN = f"{V1}/admin"
WHY = {"reason": "a season begins"}
PAPER = {"method": "a method", "modality": "C+L", "source": "somebody, a year, a table", "miou": 0.25}


def make(api: httpx.Client, caller: Person, version: str, **said: Any) -> httpx.Response:
    body = {
        "name": "stone", "title": "STONE", "description": "Traversability of voxels\nIn 3D.", "dataset": version, **WHY,
    }  # fmt: skip
    return api.post(f"{ADMIN}/benchmarks", json=body | said, headers=caller.headers)


def made(api: httpx.Client, caller: Person, version: str, **said: Any) -> dict[str, Any]:
    """The phases of a new benchmark, by name."""
    answer = make(api, caller, version, **said)
    assert answer.status_code == 201, answer.text
    return {phase["name"]: phase for phase in answer.json()["phases"]}


def change(
    api: httpx.Client, caller: Person, phase: Mapping[str, Any], match: str = "*", **said: Any
) -> httpx.Response:
    headers = caller.headers | ({"If-Match": match} if match else {})
    return api.patch(f"{ADMIN}/phases/{phase['id']}", json=WHY | said, headers=headers)


def problem(answer: httpx.Response) -> tuple[int, str]:
    return answer.status_code, answer.json()["code"]
