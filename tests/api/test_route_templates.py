"""What an access log and a metric call a route: its template, whatever its parameters are, so that none is a label."""

from typing import Any

import httpx
import pytest
from structlog.testing import capture_logs

from api.middleware.entry import template_of
from services.runtime.platform import Platform
from testing.api.serving import Person


@pytest.mark.parametrize(
    ("path", "values", "template"),
    [
        ("/jobs/0a/logs", {"job_id": "0a"}, "/jobs/{job_id}/logs"),
        ("/inputs/n-1.tar", {"name": "n-1"}, "/inputs/{name}.tar"),
        ("/exports/7/files/a/b.c/d.bin", {"id": 7, "path": "a/b.c/d.bin"}, "/exports/{id}/files/{path}"),
        ("/queues/queues/queues", {"queue": "queues", "act": "queues"}, "/queues/{queue}/{act}"),
        ("/phases/m/manifest", {"phase": "m"}, "/phases/{phase}/manifest"),
        ("/a/x.y/x", {"one": "x.y", "two": "x"}, "/a/{one}/{two}"),
        ("/files/", {"path": ""}, "/files/{path}"),
        ("/files/.*[", {"path": ".*["}, "/files/{path}"),
        ("/healthz", {}, "/healthz"),
    ],
)
def test_every_parameter_is_shown_by_its_name(path: str, values: dict[str, Any], template: str) -> None:
    assert template_of({"endpoint": print, "path": path, "path_params": values}) == template


def test_without_a_route_there_is_one_name() -> None:
    assert template_of({"path": "/made/up/by/a/stranger"}) == "unmatched"


def test_names_of_files_become_no_labels(api: httpx.Client, platform: Platform, administrator: Person) -> None:
    with capture_logs() as lines:
        for name in ("one", "two"):
            api.get(f"/api/v1/phases/{'0' * 32}/inputs/{name}.tar", headers=administrator.headers)
            api.get(f"/api/v1/sequences/{'0' * 32}/exports/{'0' * 32}/files/a/{name}", headers=administrator.headers)
    routes = [line["route"] for line in lines if line["event"] == "request"]
    assert set(routes) == {
        "/api/v1/phases/{phase_id}/inputs/{sequence_name}.tar",
        "/api/v1/sequences/{sequence_id}/exports/{export_id}/files/{path}",
    }
