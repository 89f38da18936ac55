"""Every list says the same bytes as ever, on both databases, to each who may ask.

Where an answer is meant to change, `WRITES_GOLDEN=1` writes the files anew; the difference is then looked at.
"""

import json
import os
from pathlib import Path
from urllib.parse import urlencode

import httpx
import pytest

from services.runtime.platform import Platform
from tests.api.listed.listed_rows import fill_listed
from tests.api.listed.listed_values import id_of

GOLDEN = Path(__file__).parent / "golden"
FIRST = id_of("sequence", 1)
ASKED = {
    "sequences": "/sequences", "sequences_paged": "/sequences?limit=2",
    "sequences_of_forest": "/sequences?environment=forest", "sequences_named": "/sequences?name=forest-2",
    "sequences_of_owner": f"/sequences?{urlencode({'owner_id': id_of('user', 2)})}", "jobs": "/jobs",
    "jobs_paged": "/jobs?limit=3", "jobs_of_a_run": f"/jobs?{urlencode({'root_id': id_of('job', 10)})}",
    "jobs_failed": "/jobs?state=failed", "jobs_of_a_kind": "/jobs?kind=labeler.export",
    "jobs_of_a_sequence": f"/jobs?{urlencode({'sequence_id': FIRST})}", "submissions": "/submissions",
    "submissions_queued": "/submissions?state=queued", "exports": f"/sequences/{FIRST}/exports",
    "exports_paged": f"/sequences/{FIRST}/exports?limit=1", "datasets": "/datasets",
    "datasets_paged": "/datasets?limit=1", "a_sequence": f"/sequences/{FIRST}", "a_job": f"/jobs/{id_of('job', 10)}",
    "a_submission": f"/submissions/{id_of('submission', 3)}", "me": "/me",
}  # fmt: skip
TAGGED = ("/sequences", "/jobs", "/submissions", f"/sequences/{FIRST}/exports", "/datasets")
WHO = ("ada", "bob", "root", "visitor")


def pages_of(api: httpx.Client, path: str, headers: dict[str, str]) -> list[str]:
    """The status and the body of every page."""
    found, following = list[str](), ""
    while True:
        answer = api.get(f"/api/v1{path}{following}", headers=headers | {"X-Request-ID": "golden"})
        found.append(f"{answer.status_code} {answer.headers['content-type']} {answer.text}")
        cursor = answer.json().get("next") if answer.status_code == 200 else None
        if not cursor:
            return found
        following = f"{'&' if '?' in path else '?'}cursor={cursor}"


@pytest.fixture
def listed(api_on: httpx.Client, platform_on: Platform) -> dict[str, dict[str, list[str]]]:
    people = fill_listed(platform_on)
    headers = {name: one.headers for name, one in people.items()} | {"visitor": {}}
    return {name: {who: pages_of(api_on, path, headers[who]) for who in WHO} for name, path in ASKED.items()}


def test_lists_say_the_same_bytes_as_ever(listed: dict[str, dict[str, list[str]]]) -> None:
    GOLDEN.mkdir(exist_ok=True)
    for name, answers in listed.items():
        golden = GOLDEN / f"{name}.json"
        if os.environ.get("WRITES_GOLDEN"):
            golden.write_text(json.dumps(answers, ensure_ascii=False, indent=1) + "\n")
        assert answers == json.loads(golden.read_text()), name
    assert {path.stem for path in GOLDEN.glob("*.json")} == set(ASKED)


def test_who_has_a_list_already_is_told_so_until_it_changes(api: httpx.Client, platform: Platform) -> None:
    headers = fill_listed(platform)["ada"].headers
    for path in TAGGED:
        first = api.get(f"/api/v1{path}", headers=headers)
        again = api.get(f"/api/v1{path}", headers=headers | {"If-None-Match": first.headers["etag"]})
        assert (first.status_code, again.status_code, again.content) == (200, 304, b"")
        assert again.headers["etag"] == first.headers["etag"]
    tag = {"If-None-Match": api.get("/api/v1/sequences", headers=headers).headers["etag"]}
    change = {"region": "Jeju"}
    assert api.patch(f"/api/v1/sequences/{FIRST}", json=change, headers=headers | {"If-Match": "*"}).is_success
    assert api.get("/api/v1/sequences", headers=headers | tag).status_code == 200
