"""The whole API against its own document, by schemathesis, as callers of every role: no fault, nothing undocumented.

**Conventions.** Requests are generated from the document: valid ones, valid ones about things that exist, and invalid
ones. Seeded, and few in the suite; `STONE_SCHEMATHESIS_EXAMPLES=200 pytest tests/api/test_schemathesis.py` looks
longer. A stream of events is cut after a moment, since only its beginning is looked at.
"""

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import pytest
import requests
import schemathesis
from hypothesis import HealthCheck, given, seed, settings
from hypothesis.strategies import SearchStrategy, one_of
from schemathesis import APIOperation, Case, GenerationMode
from schemathesis.specs.openapi import checks

from api.main import make_api
from api.routes import events
from services.runtime.migrate import upgrade
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings, BrokerSettings
from tests.api.access.cast import Cast, make_cast
from tests.api.access.world import make_world
from tests.api.serving import serving
from tests.servers.fixtures import make_settings, opened

EXAMPLES = int(os.environ.get("STONE_SCHEMATHESIS_EXAMPLES", "4"))
Operation = APIOperation[Any, Any, Any, Any]
ROLES = ("anonymous", "participant", "owner", "administrator")
STREAMED_S = 0.05
CHECKS = [
    schemathesis.checks.not_a_server_error,
    checks.status_code_conformance,
    checks.content_type_conformance,
    checks.response_headers_conformance,
    checks.response_schema_conformance,
    checks.unsupported_method,
    checks.allow_header_conformance,
    checks.negative_data_rejection,
]


@schemathesis.serializer("application/offset+octet-stream")
def piece(_context: schemathesis.SerializationContext, value: Any) -> Any:
    return value if isinstance(value, bytes) else str(value).encode()


@dataclass(frozen=True)
class Scene:
    """The served application, its document, and people to ask it."""

    platform: Platform
    url: str
    document: dict[str, Any]
    cast: Cast


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory, redis_url: str) -> Iterator[Scene]:
    unbound = ApiSettings(requests_per_minute=10**7, sign_ins_per_minute=10**7)
    groups = {"api": unbound, "broker": BrokerSettings(redis_url)}
    platform = opened(make_settings(tmp_path_factory.mktemp("schemathesis"), **groups), [])
    upgrade(platform.settings)
    application = make_api(platform)
    with pytest.MonkeyPatch.context() as patch, serving(platform, application) as url:
        patch.setattr(events, "LONGEST_S", STREAMED_S)
        yield Scene(platform, url, application.openapi(), make_cast(platform))
    platform.database.close()


@pytest.mark.parametrize("role", ROLES)
def test_every_answer_is_documented_and_none_is_a_fault(scene: Scene, role: str) -> None:
    schema = schemathesis.openapi.from_dict(scene.document)
    found: list[str] = []
    with requests.Session() as session:
        session.headers.update(scene.cast.headers[role])
        for operation in schema.get_all_operations():
            try:
                asking(scene, session, operation.ok())()
            except (Exception, BaseExceptionGroup) as error:
                found.append(f"{operation.ok().label}: {error}")
    print("\n\n".join(found))
    assert not found


def asking(scene: Scene, session: requests.Session, operation: Operation) -> Any:
    real = make_world(scene.platform, scene.cast.users["owner"]).named if operation.path_parameters else {}

    @seed(20260503)
    @settings(max_examples=EXAMPLES, database=None, deadline=None, suppress_health_check=list(HealthCheck))
    @given(case=cases(operation, real))
    def ask(case: Case) -> None:
        answer = case.call(base_url=scene.url, session=session)
        case.validate_response(answer, checks=CHECKS)

    return ask


def cases(operation: Operation, real: Mapping[str, str]) -> SearchStrategy[Case]:
    named = {parameter.name: real[parameter.name] for parameter in operation.path_parameters}
    valid = operation.as_strategy(GenerationMode.POSITIVE)
    existing = operation.as_strategy(GenerationMode.POSITIVE, path_parameters=named) if named else valid
    return one_of(existing, valid, operation.as_strategy(GenerationMode.NEGATIVE))
