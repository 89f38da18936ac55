"""The platform as it runs, with secrets planted wherever one can be: what it tells holds none, and tells the story.

**Conventions.** `stone serve` with workers and sweeper, a store by S3, a collector of spans. People sign in, rightly
and wrongly, upload, and are refused; the store goes away. Then all that was told is searched: log files, spans
as they came over the wire, metrics.

Catches alone a secret that any process of a real platform writes anywhere.
"""

import json
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from secrets import token_hex
from typing import Any

import httpx
import pytest

from testing.api.tus import PIECE, TUS, metadata
from testing.servers.collector import Collector, facts_of, running_collector
from testing.servers.process import free_port
from testing.servers.s3 import S3Server, running_s3
from testing.stone_serve import environment, serving, until

pytestmark = pytest.mark.whole

V1 = "/api/v1"
GARBAGE = b"\x89MCAP0\r\n" + bytes(5000)
CONSOLE = "serve.stderr"
CONSUMER = 5


@dataclass
class Told:
    """What the platform told, and what was planted."""

    collector: Collector
    planted: dict[str, str]
    logs: dict[str, str] = field(default_factory=dict)
    exposed: str = ""
    job_id: str = ""
    request_id: str = ""

    def lines(self, **facts: Any) -> list[dict[str, Any]]:
        """The lines that say so, of all logs."""
        lines = (line for text in self.logs.values() for line in text.splitlines() if line.startswith("{"))
        said = [json.loads(line) for line in lines]
        return [one for one in said if all(one.get(name) == value for name, value in facts.items())]


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Told]:
    data = tmp_path_factory.mktemp("told") / "data"
    with running_s3() as s3, running_collector() as collector:
        told = Told(collector, {"metrics": token_hex(20), "collector": token_hex(20), "S3": s3.secret})
        with serving(data, **_variables(told, s3)) as platform:
            told.planted["local token"] = platform.token
            told.planted["first password"] = (data / "admin-password").read_text().strip()
            with httpx.Client(base_url=platform.url, timeout=300) as api:
                _live(api, told, s3)
            assert platform.stop() == 0
        told.logs = {path.name: path.read_text() for path in [*(data / "logs").iterdir(), platform.output]}
        yield told


def _variables(told: Told, s3: S3Server) -> Mapping[str, str]:
    store = s3.settings()
    return {
        "STONE_API__METRICS_TOKEN": told.planted["metrics"],
        "STONE_JOBS__REST_S": "0.1",
        "STONE_STORE__S3_BUCKET": store.s3_bucket,
        "STONE_STORE__S3_ENDPOINT": store.s3_endpoint,
        "STONE_STORE__S3_KEY_ID": store.s3_key_id,
        "STONE_STORE__S3_SECRET": store.s3_secret.get_secret_value(),
        "OTEL_EXPORTER_OTLP_ENDPOINT": told.collector.url,
        "OTEL_EXPORTER_OTLP_HEADERS": f"authorization=Bearer {told.planted['collector']}",
        "OTEL_BSP_SCHEDULE_DELAY": "200",
    }


def _live(api: httpx.Client, told: Told, s3: S3Server) -> None:
    token = _sign_in(api, told)
    _knock(api, told)
    told.job_id, told.request_id = _bring(api, token, GARBAGE)
    _ended(api, token, told.job_id)
    told.exposed = _exposed(api, told)
    s3.stop()
    assert api.get("/readyz").status_code == 503
    lost_id, _ = _bring(api, token, GARBAGE + b"x")
    _ended(api, token, lost_id)


def _sign_in(api: httpx.Client, told: Told) -> str:
    """A new user's token, made by their browser's session; an administrator's made the user."""
    password, wrong = token_hex(10), token_hex(10)
    session = _session(api, told, "admin", told.planted["first password"])
    user = {"name": "field", "role": "curator", "password": password, "reason": "joins"}
    assert api.post(f"{V1}/admin/users", json=user, headers=session).status_code == 201
    assert api.post(f"{V1}/sessions", json={"name": "field", "password": wrong}).status_code == 401
    session = _session(api, told, "field", password)
    issued = api.post(f"{V1}/tokens", json={"name": "laptop"}, headers=session)
    assert issued.status_code == 201, issued.text
    told.planted |= {"password": password, "wrong password": wrong, "token": issued.json()["secret"]}
    api.cookies.clear()
    return str(issued.json()["secret"])


def _session(api: httpx.Client, told: Told, name: str, password: str) -> dict[str, str]:
    """The header that a browser's session repeats; its cookie is the client's from now on."""
    api.cookies.clear()
    answer = api.post(f"{V1}/sessions", json={"name": name, "password": password})
    assert answer.status_code == 201, answer.text
    csrf = str(answer.json()["csrf_token"])
    told.planted |= {f"cookie of {name}": str(cookie.value) for cookie in api.cookies.jar}
    told.planted[f"csrf of {name}"] = csrf
    return {"X-CSRF-Token": csrf}


def _knock(api: httpx.Client, told: Told) -> None:
    """Secrets of others, shown in all the wrong places."""
    told.planted |= {name: token_hex(20) for name in ("bearer", "basic", "query", "path", "cookie", "body", "field")}
    planted = told.planted
    api.get(f"{V1}/me", headers={"Authorization": f"Bearer stone_{planted['bearer']}"})
    api.get(f"{V1}/me", headers={"Authorization": f"Basic {planted['basic']}"})
    api.get(f"{V1}/sequences", params={"cursor": planted["query"], "token": planted["query"]})
    api.get(f"{V1}/{planted['path']}")
    api.get(f"{V1}/sequences/{planted['path']}")
    api.get("/", headers={"Cookie": f"stone_session={planted['cookie']}"})
    api.post(f"{V1}/sessions", json={"name": "field", "password": {"no": planted["body"]}})
    api.post(f"{V1}/sessions", json={"name": planted["field"], "password": "in the wrong field"})
    api.post(f"{V1}/sessions", content=b"{" + planted["body"].encode())


def _bring(api: httpx.Client, token: str, content: bytes) -> tuple[str, str]:
    """A recording that is none: the job that finds it out, and the request that queued it."""
    own = {"Authorization": f"Bearer {token}"}
    sequence = api.post(f"{V1}/sequences", json={"name": f"s-{token_hex(4)}"}, headers=own).json()["id"]
    said = {"filename": "run.mcap", "purpose": "recording", "target_id": sequence}
    said["sha256"] = sha256(content).hexdigest()
    head = {**TUS, **own, "Upload-Length": str(len(content)), "Upload-Metadata": metadata(**said)}
    where = api.post(f"{V1}/uploads", headers=head).headers["Location"]
    sent = api.patch(where, content=content, headers={**PIECE, **own, "Upload-Offset": "0"})
    assert sent.status_code == 204, sent.text
    body = {"upload_id": where.rsplit("/", 1)[1]}
    accepted = api.post(f"{V1}/sequences/{sequence}/recordings", json=body, headers=own)
    assert accepted.status_code == 202, accepted.text
    return accepted.json()["job"]["id"], accepted.headers["X-Request-ID"]


def _ended(api: httpx.Client, token: str, job_id: str) -> None:
    own = {"Authorization": f"Bearer {token}"}

    def has_ended() -> bool:
        return api.get(f"{V1}/jobs/{job_id}", headers=own).json()["state"] in {"failed", "succeeded"}

    until(has_ended)


def _exposed(api: httpx.Client, told: Told) -> str:
    """The metrics, once a worker has told what it counted."""
    watching = {"Authorization": f"Bearer {told.planted['metrics']}"}
    until(lambda: "stone_job_seconds_count" in api.get("/metrics", headers=watching).text)
    return api.get("/metrics", headers=watching).text


def test_no_secret_is_told(told: Told) -> None:
    spans = b"\n".join(told.collector.received).decode("utf-8", "replace")
    everything = {**told.logs, "metrics": told.exposed, "spans": spans}
    console = everything.pop(CONSOLE)
    for name, secret in told.planted.items():
        assert [where for where, text in everything.items() if secret in text] == [], name
        assert secret not in console or name == "first password", name  # that one is told to whoever starts it
    assert {"api.log", "worker.log", "sweeper.log"} <= set(everything)
    assert len(told.planted) >= 19
    assert all(len(secret) >= 16 for secret in told.planted.values())


def test_a_trace_leads_from_the_upload_to_the_job_that_reads_it(told: Told) -> None:
    spans = told.collector
    created = {span.trace_id for span in spans.named("POST /api/v1/uploads")}
    sent = spans.named("PATCH /api/v1/uploads/{upload_id}")
    asked = spans.named("POST /api/v1/sequences/{sequence_id}/recordings")
    assert len(created) == len(sent) == len(asked) == 2
    for span in (*sent, *asked):
        assert [link.trace_id in created for link in span.links] == [True]
    attempts = [span for service, span in spans.spans if service == "stone-worker" and span.kind == CONSUMER]
    assert {span.trace_id for span in attempts} == {span.trace_id for span in asked}
    first = min(attempts, key=lambda span: span.start_time_unix_nano)
    assert facts_of(first)["stone.job.id"] == told.job_id
    assert first.parent_span_id in {span.span_id for span in asked}


def test_lines_of_request_and_attempt_name_each_other(told: Told) -> None:
    (request,) = told.lines(event="request", request_id=told.request_id)
    (attempt,) = told.lines(event="attempt ended", job_id=told.job_id)
    assert attempt["request_id"] == told.request_id
    assert (attempt["run_id"], attempt["attempt"]) == (told.job_id, 1)
    assert attempt["trace_id"] == request["trace_id"]
    assert attempt["span_id"] != request["span_id"]


def test_processes_that_reach_nothing_say_no_password(tmp_path: Path) -> None:
    planted = {"database": token_hex(12), "broker": token_hex(12)}
    away = free_port()
    variables = {
        "STONE_DATABASE__URL": f"postgresql://stone:{planted['database']}@127.0.0.1:{away}/stone",
        "STONE_DATABASE__AWAITED_S": "3",
        "STONE_BROKER__URL": f"redis://:{planted['broker']}@127.0.0.1:{away}/0",
    }
    env = environment(tmp_path / "data", **variables)
    began = [
        subprocess.Popen(
            [sys.executable, "-m", f"services.{module}", *arguments],
            env=env,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        for module, *arguments in (("maintenance.sweeper",), ("runtime.processes.worker", "eval"))
    ]
    said = "".join(process.communicate(timeout=300)[0] for process in began)
    assert all(process.returncode for process in began)
    assert "waiting" in said
    assert [name for name, secret in planted.items() if secret in said] == []
