"""The document says of every route what it takes and every way it can answer."""

import importlib
import json
import pkgutil
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from openapi_spec_validator import OpenAPIV31SpecValidator
from pydantic import BaseModel, ValidationError

import api.schemas
from api.openapi import operations
from api.problems import MEDIA_TYPE
from api.schemas.base import Answer, Body, instant
from api.schemas.notifications import DeliveryItem
from api.words import FIELDS, PARAMETERS
from services.runtime.access.roles import ROLES, SCOPES
from services.runtime.platform import Platform
from testing.api.serving import client_of

VERBS = re.compile(
    r"(activate|abandon|append|assign|cancel|change|choose|compare|count|create|decide|delete|describe|dismiss|download|erase|finalize|finish|follow|grant|"
    r"join|judge|list|override|process|propose|put|remove|replace|revoke|rotate|save|set|show|start|steer|switch|take|terminate|verify|withdraw)_[a-z]+(_[a-z]+)*"
)
PUBLIC = {
    ("/healthz", "get"), ("/readyz", "get"), ("/api/v1/problems", "get"), ("/api/v1/problems/{code}", "get"),
    ("/api/v1/docs", "get"), ("/api/v1/client", "get"), ("/api/v1/sessions", "post"), ("/api/v1/sign-in", "get"),
    ("/api/v1/sign-in/oidc", "get"), ("/api/v1/sign-in/oidc/callback", "get"), ("/api/v1/device-grants", "post"),
    ("/api/v1/device-grants/token", "post"), ("/api/v1/uploads", "options"),
}  # fmt: skip


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    from api.main import make_api
    from testing.servers.fixtures import make_settings, opened

    made: dict[str, Any] = make_api(opened(make_settings(tmp_path_factory.mktemp("api")), [])).openapi()
    return made


def test_the_document_is_served_to_everybody_and_is_json(platform: Platform, document: dict[str, Any]) -> None:
    with client_of(platform) as api:
        answer = api.get("/api/v1/openapi.json")
    assert answer.status_code == 200
    assert answer.json() == json.loads(json.dumps(document))
    assert answer.json()["openapi"].startswith("3.1")


def test_the_document_is_valid_openapi_3_1(document: dict[str, Any]) -> None:
    assert document["openapi"].startswith("3.1")
    assert [
        (list(error.absolute_path), error.message) for error in OpenAPIV31SpecValidator(document).iter_errors()
    ] == []


def test_only_what_is_meant_to_be_public_asks_for_no_caller(document: dict[str, Any]) -> None:
    public = {(path, method) for path, method, operation in operations(document) if "security" not in operation}
    assert public == PUBLIC


def test_every_operation_says_what_it_takes_who_may_ask_and_how_it_can_answer(document: dict[str, Any]) -> None:
    names = []
    for path, method, operation in operations(document):
        at = (path, method)
        asked_for = [asked for requirement in operation.get("security", []) for asked in requirement.values()]
        assert all(asked and asked[0] in SCOPES and set(asked[1:]) <= set(ROLES) for asked in asked_for), at
        assert operation["summary"], at
        assert operation["tags"], at
        names.append(operation["operationId"])
        assert VERBS.fullmatch(operation["operationId"]), at
        for status, answer in operation["responses"].items():
            if int(status) >= 400 and (path, status) != ("/readyz", "503"):
                schema = answer["content"][MEDIA_TYPE]["schema"]
                assert schema == {"$ref": "#/components/schemas/Problem"}, (*at, status)
        answers = {int(status) for status in operation["responses"]}
        assert any(200 <= status < 400 for status in answers), at
        assert not path.startswith("/api/") or answers >= {429, 500, 503}, at
        assert "security" not in operation or answers >= {401, 403}, at
        assert "requestBody" not in operation or answers >= {413, 415, 422}, at
        assert 404 in answers or not re.search(r"\{\w+(_id|token)\}", path), at
        parameters = {parameter["name"] for parameter in operation.get("parameters", ())}
        assert ("Idempotency-Key" in parameters) == (method == "post" and "security" in operation), at
    assert len(names) == len(set(names))


def test_every_body_has_an_example(document: dict[str, Any]) -> None:
    schemas = document["components"]["schemas"]
    bare = []
    for path, method, operation in operations(document):
        for content in (operation.get("requestBody") or {}).get("content", {}).values():
            name = content["schema"].get("$ref", "").rpartition("/")[2]
            is_form = "multipart" in str(operation["requestBody"])
            if name and not is_form and content.get("example") != schemas[name].get("examples", [None])[0]:
                bare.append((path, method, name))
    assert bare == []


def test_every_list_comes_in_one_envelope(document: dict[str, Any]) -> None:
    schemas = document["components"]["schemas"]
    said = json.dumps([operation["responses"] for _, _, operation in operations(document)])
    assert '"type": "array"' not in said
    pages = {name for name in re.findall(r"#/components/schemas/(\w+)", said) if "items" in schemas[name]["properties"]}
    assert len(pages) >= 30
    assert {tuple(schemas[name]["properties"]) for name in pages} == {("items", "next")}


def test_no_two_schemas_have_one_name(document: dict[str, Any]) -> None:
    assert [name for name in document["components"]["schemas"] if "__" in name] == []


def test_every_property_and_parameter_is_described_by_a_sentence(document: dict[str, Any]) -> None:
    schemas = document["components"]["schemas"]
    said = {f"{name}.{field}": value for name, schema in schemas.items()
            for field, value in schema.get("properties", {}).items()}  # fmt: skip
    for path, method, operation in operations(document):
        said |= {f"{method} {path} {one['name']}": one for one in operation.get("parameters", ())}
    said |= schemas
    assert [name for name, value in said.items() if not re.match(r"[A-Z`].*[.…]$", value["description"], re.S)] == []


def test_every_sentence_describes_something(document: dict[str, Any]) -> None:
    schemas = document["components"]["schemas"].items()
    fields = {name for schema, value in schemas for field in value.get("properties", {})
              for name in (field, f"{schema}.{field}")}  # fmt: skip
    parameters = {one["name"] for _, _, operation in operations(document) for one in operation.get("parameters", ())}
    assert set(FIELDS) <= fields
    assert set(PARAMETERS) <= parameters


def test_the_document_names_its_server_and_generates_no_package_that_is_ours(document: dict[str, Any]) -> None:
    assert [one["url"] for one in document["servers"]] == ["/"]
    package = document["info"]["title"].lower().replace(" ", "_") + "_client"  # as openapi-python-client makes it
    assert not (Path(api.schemas.__file__).parents[2] / package).exists()


def test_the_pages_for_people_need_no_other_host(api: httpx.Client) -> None:
    answer = api.get("/api/v1/docs")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/html")
    assert "://" not in re.sub(r"http://127\.0\.0\.1:\d+|https://chat\.example\.org", "", answer.text)
    assert "<script" not in answer.text
    assert "default-src 'none'" in answer.headers["content-security-policy"]
    for path in ("/api/v1/tokens", "/api/v1/sequences/{sequence_id}/process", "/readyz"):
        assert path in answer.text


MODULES = [importlib.import_module(f"api.schemas.{found.name}") for found in pkgutil.iter_modules(api.schemas.__path__)]
MODELS = sorted(
    {
        model
        for module in MODULES
        for model in vars(module).values()
        if isinstance(model, type) and issubclass(model, (Answer, Body)) and model not in (Answer, Body)
    },
    key=lambda model: model.__name__,
)
GLANCES = {
    "BenchmarkShown",  # generic: its two leaves have one
    "JobGlance",
    "LabelGlance",
    "Shares",
    "VoxelRatios",
}  # shown within the example of what holds them


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_an_example_is_one(model: type[BaseModel]) -> None:
    extra = model.model_config.get("json_schema_extra")
    examples = extra["examples"] if isinstance(extra, dict) else []
    assert bool(examples) != (model.__name__.partition("[")[0] in GLANCES)
    assert isinstance(examples, list)
    for example in examples:
        assert isinstance(example, dict)
        read = model.model_validate(example)
        written = json.loads(read.model_dump_json())
        assert issubclass(model, Body) or written == example


@pytest.mark.parametrize("model", [model for model in MODELS if issubclass(model, Body)], ids=lambda m: m.__name__)
def test_a_body_knows_its_keys(model: type[BaseModel]) -> None:
    with pytest.raises(ValidationError, match="extra_forbidden"):
        model.model_validate({"no_such_key": 1})


def test_a_field_that_is_given_hides_the_attribute_of_the_value() -> None:
    row = SimpleNamespace(id="1", channel="email", state="dead", tries=3, answer="", secret="s")
    row.created_ns, row.due_ns, row.ended_ns = 0, 1000, None
    item = DeliveryItem.of(row, kind="run.done", due_at=None)
    assert (item.created_at, item.due_at, item.ended_at) == (instant(0), None, None)
    assert "secret" not in item.model_dump()


def test_an_instant_is_utc_to_the_microsecond() -> None:
    assert instant(1_777_800_000_123_456_789).isoformat() == "2026-05-03T09:20:00.123456+00:00"
