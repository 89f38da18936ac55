"""The whole API against its own document, by schemathesis, as callers of every role: no fault, nothing undocumented.

**Conventions.** Requests are generated from the document: valid ones, valid ones about things that exist, and invalid
ones. Seeded, and few in the suite; `STONE_SCHEMATHESIS_EXAMPLES=200 pytest tests/api/test_schemathesis.py` looks
longer. A stream of events is cut after a moment, since only its beginning is looked at.

Catches alone an answer that the document does not know, of requests nobody thought of.
"""

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import pytest
import requests
import schemathesis
from hypothesis import HealthCheck, given, seed, settings
from hypothesis.strategies import SearchStrategy, one_of
from schemathesis import APIOperation, Case, GenerationMode
from schemathesis.core.result import Ok
from schemathesis.specs.openapi import checks
from sqlalchemy import delete, update

from api.deps import SAFE
from api.main import make_api
from api.routes import events
from services.domain.datasets.composition_figure import composition_png
from services.domain.datasets.statistics import statistics_record
from services.runtime.database.migrate import upgrade
from services.runtime.orm import Queue, User
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings, BrokerSettings
from testing.api.serving import serving
from testing.servers.fixtures import make_settings, opened
from tests.api.access.cast import Cast, make_cast
from tests.api.access.world import World, make_world

pytestmark = pytest.mark.whole

EXAMPLES = int(os.environ.get("STONE_SCHEMATHESIS_EXAMPLES", "4"))
Operation = APIOperation[Any, Any, Any, Any]
ROLES = ("anonymous", "participant", "owner", "administrator")
SUCCEEDING = {"anonymous": 5, "participant": 13, "owner": 32, "administrator": 40}  # operations, of four examples each
LAST = "DELETE /api/v1/tokens/current"  # whoever asks it has asked for the last time
STREAMED_S = 0.05
REFUSING = ["400", "401", "403", "404", "405", "409", "412", "413", "415", "416", "422", "428"]
PATIENCE_S = 120.0  # splits proposed for all that was made meanwhile take seconds
CONFIG = {"request-timeout": PATIENCE_S, "checks": {"negative_data_rejection": {"expected-statuses": REFUSING}}}
CHECKS = [
    schemathesis.checks.not_a_server_error, checks.status_code_conformance, checks.content_type_conformance,
    checks.response_headers_conformance, checks.response_schema_conformance, checks.unsupported_method,
    checks.allow_header_conformance, checks.negative_data_rejection,
]  # fmt: skip


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
    composition_png(statistics_record({}), "")  # loading what draws takes longer than a client waits
    with pytest.MonkeyPatch.context() as patch, serving(platform, application) as url:
        patch.setattr(events, "LONGEST_S", STREAMED_S)
        yield Scene(platform, url, application.openapi(), make_cast(platform))
    platform.database.close()


@pytest.mark.parametrize("role", [*(pytest.param(role, marks=pytest.mark.release) for role in ROLES[:-1]), ROLES[-1]])
def test_every_answer_is_documented_and_none_is_a_fault(scene: Scene, role: str) -> None:
    schema = schemathesis.openapi.from_dict(scene.document, config=schemathesis.Config.from_dict(CONFIG))
    answered = Answered()
    with requests.Session() as session:
        session.headers.update(scene.cast.headers[role])
        found = list(schema.get_all_operations())
        operations = [result.ok() for result in found if isinstance(result, Ok)]
        assert len(operations) == len(found), found
        for operation in sorted(operations, key=lambda operation: operation.label == LAST):
            answered.ask(scene, session, operation)
    assert not answered.wrong, "\n\n".join(answered.wrong)
    assert len(answered.succeeding) >= SUCCEEDING[role], sorted(answered.succeeding)


@dataclass
class Answered:
    """What was wrong with answers, and which operations succeeded at least once."""

    wrong: list[str] = field(default_factory=list)
    succeeding: set[str] = field(default_factory=set)
    world: World | None = None
    version: str = ""

    def ask(self, scene: Scene, session: requests.Session, operation: Operation) -> None:
        """Requests of this operation until one is answered wrongly, or as many as there are to be.

        A world serves until something in it was changed; its published version, which nothing changes, serves on.
        """
        with scene.platform.database.transaction() as database:
            database.execute(delete(Queue))  # whatever an earlier request drained is open again
            owner = scene.cast.users["owner"]  # deactivated or erased by an earlier request
            database.execute(update(User).where(User.id == owner.id).values(is_active=True))
        self.world = self.world or make_world(scene.platform, owner, self.version)
        real, self.version = self.world.named, self.world.named["dataset_name"]

        @seed(20260503)
        @settings(max_examples=EXAMPLES, database=None, deadline=None, suppress_health_check=list(HealthCheck))
        @given(case=cases(operation, real))
        def asked(case: Case[Any]) -> None:
            answer = case.call(base_url=scene.url, session=session)
            if answer.status_code < 400:
                self.succeeding.add(operation.label)
                self.world = self.world if operation.method.upper() in SAFE else None
            case.validate_response(answer, checks=CHECKS)

        try:
            asked()
        except (Exception, BaseExceptionGroup) as error:
            self.wrong.append(f"{operation.label}: {error}")


def cases(operation: Operation, real: Mapping[str, str]) -> SearchStrategy[Case[Any]]:
    """Valid requests about things that exist, valid ones about anything, invalid ones."""
    named = {parameter.name: real[parameter.name] for parameter in operation.path_parameters}
    valid = operation.as_strategy(GenerationMode.POSITIVE)
    existing = operation.as_strategy(GenerationMode.POSITIVE, path_parameters=named) if named else valid
    return one_of(existing, valid, operation.as_strategy(GenerationMode.NEGATIVE))
