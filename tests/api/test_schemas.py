"""The examples in the document are true: each is what its own model would read and write."""

import importlib
import json
import pkgutil

import pytest
from pydantic import BaseModel, ValidationError

import api.schemas
from api.schemas.base import Answer, Body, instant

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
    "ClassVoxels",
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


def test_an_instant_is_utc_to_the_microsecond() -> None:
    assert instant(1_777_800_000_123_456_789).isoformat() == "2026-05-03T09:20:00.123456+00:00"
