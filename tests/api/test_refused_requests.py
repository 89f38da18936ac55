"""What no request may say: each of these is refused whole, by what is wrong with it alone."""

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import httpx
import pytest

from api.openapi import operations
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings
from testing.api.serving import client_of
from testing.worlds.made import NOBODY
from tests.api.access.cast import Cast, make_cast
from tests.api.access.world import World, make_world

Change = dict[str, Any]
ESCAPE = "a\u001b[2J"
HIDDEN = "a\u202eb"
REASONS: list[Change] = [{"reason": one} for one in ("", "  ", None, ESCAPE, "x" * 501)]
ADA = {"name": "ada", "role": "curator", "reason": "joins the field team"}

BODIES: dict[str, tuple[Change, list[Change]]] = {
    "POST sequences": ({"name": "a"}, [
        *({"name": one} for one in ("", "../etc", "a b", ".hidden", "a\n", "é", "a" * 101, 7, None)),
        {"environment": "x" * 65}, {"region": "a\0b"}, {"owner_id": NOBODY}, {"revision": 9},
    ]),
    "PUT sequences/{sequence_id}/calibration": ({"calibration_id": "{calibration_id}"}, [{"calibration_id": "x"}]),
    "POST sequences/{sequence_id}/process": ({}, [
        {"profile": "own"}, {"parameters": {"reference.alpha": True}}, {"stages": []}, {"speed": "fast"},
        {"lidar_topic": "/a b"}, {"odometry_topic": "/a\n"}, {"recording_ids": ["run.mcap"]},
        {"recording_ids": ["ab" * 16] * 65}, {"clock_offsets_s": {"a.mcap": 1e12}}, {"clock_offsets_s": {"": 0.1}},
        {"clock_offsets_s": {"a.mcap": "soon"}}, {"clock_offsets_s": {f"{number}.mcap": 0.1 for number in range(65)}},
    ]),
    "PUT profiles/rover": ({"topics": {"lidar": "/points"}}, [{"topics": one} for one in (
        {"lidarr": "/points"}, {"cam_front": "/image"}, {"lidar": ""}, {"lidar": " /points"}, {"lidar": "/po\0ints"},
        {"lidar": "x" * 257}, {"lidar": 3}, {"lidar": "/a", "CAM_FRONT": "/a"},
        {f"CAM_{number}": f"/{number}" for number in range(65)},
    )]),
    "POST dataset-imports": ({"upload_id": "{dataset_upload}"}, [
        {"existing": "replace"}, {"name": ""}, {"name": "a" * 101}, {"name": HIDDEN}, {"classes": ""}, {"is": 1},
    ]),
    "POST tokens": ({"name": "x"}, [
        *({"name": one} for one in ("", "x" * 65, "a\0b")), {"scopes": []}, {"scopes": ["king"]},
        {"scopes": ["read"] * 6}, {"expires_s": 0}, {"expires_s": 1e12}, {"role": "administrator"},
    ]),
    "POST device-grants": ({"name": "x", "scopes": ["read"]}, [{"scopes": ["read", "account"]}]),
    "POST teams": ({"name": "us"}, [{"name": one} for one in ("", "  ", "x" * 65, "a\0", "a\nb", 7, None)]),
    "POST teams/{team_id}/invitations": ({}, [
        {"expires_s": 59}, {"expires_s": 61 * 86400}, {"expires_s": "soon"}, {"to": "eve"},
    ]),
    "POST phases/{phase_id}/submissions": (
        {"team_id": "{team_id}", "method": "Net", "modality": "L", "sha256": "0" * 64, "size_bytes": 1}, [
            {"sha256": "0" * 63}, {"size_bytes": 0}, {"modality": "L+C"}, {"method": HIDDEN}, {"method": " "},
            {"description": "x" * 20_001}, {"description": "bell\x07"}, {"kind": "validation"}, {"state": "scored"},
        ],
    ),
    "POST notifications/email/verification": ({"secret": "x" * 43}, [
        {"secret": one} for one in ("", "short", "x" * 65, "<script>")
    ]),
    "POST admin/users": (ADA, [
        *({"name": one} for one in ("Ada", "a b", "ada\n")), *REASONS, {"role": "king"}, {"is_admin": True},
    ]),
    "POST admin/jobs/acts": ({"act": "cancel", "job_ids": ["{job_id}"], "reason": "why"}, [
        {"job_ids": []}, {"job_ids": [NOBODY] * 201}, {"job_ids": ["x"]}, {"act": "revive"}, {"more": 1}, *REASONS,
    ]),
    "POST admin/jobs/{job_id}/cancel": ({"reason": "why"}, REASONS),
    "POST admin/jobs/{job_id}/terminate": ({"reason": "why"}, REASONS),
    "POST admin/queues/ingest/pause": ({"reason": "why"}, REASONS),
    "POST admin/datasets/{dataset_name}/inputs": ({"reason": "why"}, REASONS),
    "POST admin/phases/{phase_id}/inputs": ({"reason": "why"}, REASONS),
    "POST datasets": ({"name": "stone-9", "reason": "why"}, [
        *({"name": one} for one in ("", "../x", "a b", "x" * 65, ".hidden")), *REASONS,
    ]),
    "PUT splits": ({"train": [], "val": [], "test": [], "reason": "why"}, REASONS),
    "POST splits/proposal": ({"sizes": {"train": 1, "val": 0, "test": 0}}, [
        {"sizes": {"train": -1, "val": 0, "test": 0}},
    ]),
}  # fmt: skip

PAGES: list[Change] = [{"limit": 0}, {"limit": 201}, {"limit": "x"}, {"cursor": "x" * 513}, {"cursor": ""},
                       {"cursor": "%00"}, {"cursor": "!"}]  # fmt: skip
BOARD = "benchmarks/{benchmark_name}/phases/{phase_name}"
QUERIES: dict[str, list[Change]] = {
    "sequences": [*PAGES, {"name": "a\0"}, {"owner_id": "me"}, {"region": "\n"}],
    "teams": PAGES,
    "tokens": PAGES,
    "jobs": [{"state": "lost"}, {"kind": "a\0"}, {"sequence_id": "x"}, {"root_id": ""}, {"cursor": "e30"}],
    "jobs/{job_id}/logs": [{"after": one} for one in (
        "", "x", "1.2.3.4", f"1.{NOBODY}.1", f"-1.{NOBODY}.1.1", f"{10**19}.{NOBODY}.1.1",
    )],
    "sequences/{sequence_id}/recordings/{recording_id}/roles": [{"topic": one} for one in (
        "lidar", "=/a", "sonar=/a", "lidar=", "lidar=a\n",
    )],
    "calibrations/{calibration_id}/diff": [{"against": "x"}],
    f"{BOARD}/leaderboard": [
        {"track": "X"}, {"track": "L+C"}, {"as_of": "yesterday"}, {"as_of": "2026-01-01T00:00:00"},
        {"as_of": "9999-12-31T23:59:59Z"}, {"entries": "worst"}, {"format": "html"},
    ],
    f"{BOARD}/leaderboard/history": [{"track": "X"}],
    f"{BOARD}/compare": [{"a": NOBODY}, {"a": "x", "b": "y"}],
    "submissions/{scored_submission}/results/breakdowns": [{}, {"by": "weather"}, {"by": "sequence", "score": "x"}],
    "admin/audit-log": [{"actor_id": "x"}, {"act": "a\0"}, {"subject_id": "x" * 65}, {"limit": 0}],
    "admin/jobs": [{"id_part": one} for one in ("abc", "%%%%", "ABCD", "a" * 33)],
    "admin/users": [{"role": "king"}],
}  # fmt: skip
CODES = ("invalid_request", "bad_cursor", "TOP-113")
PATHS = {
    404: ["POST admin/queues/other/pause", "POST admin/jobs/{unknown}/cancel"],
    422: ["POST admin/queues/eval/purge", "POST admin/jobs/{unknown}/revive",
          "GET sequences/{sequence_id}/scene/tiles/x",
          *(f"DELETE tokens/{one}" for one in ("x", "0" * 31, "0" * 33, "G" * 32, "%00" * 32))],
}  # fmt: skip


class Asking:
    """A curator with one of everything, and an administrator for what is theirs."""

    def __init__(self, api: httpx.Client, cast: Cast, world: World) -> None:
        self.api, self.cast, self.named = api, cast, {**world.named, "unknown": NOBODY}

    def __call__(self, method: str, path: str, **asked: Any) -> httpx.Response:
        is_theirs = path.startswith(("admin/", "datasets", "splits"))
        headers = {**self.cast.headers["administrator" if is_theirs else "owner"], "If-Match": "*"}
        where = f"/api/v1/{path}".format_map(self.named)
        return self.api.request(method, where, headers=headers, **asked)

    def said(self, body: Change) -> Change:
        """The body with ids that exist."""
        return {key: self._real(value) for key, value in body.items()}

    def _real(self, value: Any) -> Any:
        if isinstance(value, list):
            return [self._real(one) for one in value]
        is_named = isinstance(value, str) and value.startswith("{")
        return self.named[value[1:-1]] if is_named else value


@pytest.fixture
def ask(platform: Platform) -> Iterator[Asking]:
    cast = make_cast(platform)
    settings = platform.settings.model_copy(
        update={"api": ApiSettings(requests_per_minute=10**7, sign_ins_per_minute=10**7)}
    )
    with client_of(replace(platform, settings=settings)) as api:
        yield Asking(api, cast, make_world(platform, cast.users["owner"]))


def test_a_body_with_one_thing_wrong_is_refused_and_without_it_is_not(ask: Asking) -> None:
    wrong = []
    for named, (body, changes) in BODIES.items():
        for change in changes:
            answer = ask(*named.split(), json=ask.said(body | change))
            if (answer.status_code, answer.json().get("code")) not in {(422, code) for code in CODES}:
                wrong.append((named, change, answer.text))
    assert wrong == []
    accepted = {named: ask(*named.split(), json=ask.said(body)).status_code for named, (body, _) in BODIES.items()}
    assert [named for named, status in accepted.items() if status == 422] == []


def test_a_query_or_path_that_cannot_be_meant_is_refused(ask: Asking) -> None:
    wrong = []
    for path, queries in QUERIES.items():
        for query in queries:
            answer = ask("GET", path, params=query)
            if (answer.status_code, answer.json().get("code")) not in {(422, code) for code in CODES}:
                wrong.append((path, query, answer.text))
    for status, paths in PATHS.items():
        for one in paths:
            answer = ask(*one.split(), **({} if one.startswith("GET") else {"json": {"reason": "why"}}))
            if answer.status_code != status:
                wrong.append((one, status, answer.text))
    assert wrong == []


def test_every_route_refuses_an_unknown_query_parameter_and_names_the_known_ones(ask: Asking) -> None:
    document = ask.api.get("/api/v1/openapi.json").json()
    taking_any = {"/healthz", "/readyz", "/metrics", "/api/v1/sign-in/oidc/callback"}
    wrong = []
    for path, method, operation in operations(document):
        answer = ask.api.request(method, re.sub(r"\{\w+\}", "x", path), params={"no_such": "hunter2"})
        names = sorted(one["name"] for one in operation.get("parameters", ()) if one["in"] == "query")
        expected = f"one of {', '.join(names)}" if names else "no query parameters"
        refused = answer.status_code == 422 and method != "head" and answer.json()["errors"]
        detail = f"unknown query parameter; expected {expected}"
        finding = {"code": "unknown_parameter", "where": "query.no_such", "expected": expected, "detail": detail}
        is_right = answer.status_code == 422 if method == "head" else refused == [finding]
        if is_right == (path in taking_any) or "hunter2" in answer.text:
            wrong.append((path, method, answer.status_code, answer.text[:200]))
    assert wrong == []


def test_an_answer_of_a_provider_may_have_parameters_that_we_do_not_know(ask: Asking) -> None:
    answer = ask.api.get("/api/v1/sign-in/oidc/callback", params={"state": "x", "session_state": "y"})
    assert answer.json()["code"] == "no_provider"
