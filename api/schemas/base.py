"""Base models and field types of all request and response bodies."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from functools import cache
from types import NoneType
from typing import Annotated, Any, Self, get_args, get_origin

from fastapi import Path, Query
from pydantic import AliasChoices, AliasGenerator, BaseModel, BeforeValidator, ConfigDict, StringConstraints
from pydantic_core import PydanticCustomError

from stone.errors import StoneError

ID_EXAMPLE = "019aa5b0c1d24f6e8a7b3c5d9e0f1a2b"
SHA256_EXAMPLE = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
MADE = "2026-05-03T09:12:44.120000Z"
ID_PATTERN = "^[0-9a-f]{32}$"
# No control or invisible characters, nor text direction marks: a name could look like another.
PLAIN = r"^[^\x00-\x1f\x7f-\x9f\u00ad\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb]*$"
# PLAIN plus line feeds and tabs, for texts of several lines.
PROSE = r"^[^\x00-\x08\x0b-\x1f\x7f-\x9f\u00ad\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb]*$"

IdText = Annotated[str, StringConstraints(pattern=ID_PATTERN)]
Line = Annotated[str, StringConstraints(pattern=PLAIN, max_length=64, strip_whitespace=True)]
Reason = Annotated[str, StringConstraints(pattern=PLAIN, min_length=1, max_length=500, strip_whitespace=True)]
IdPath = Annotated[str, Path(pattern=ID_PATTERN, examples=[ID_EXAMPLE])]
LineQuery = Annotated[str | None, Query(pattern=PLAIN, max_length=64)]
IdQuery = Annotated[str | None, Query(pattern=ID_PATTERN)]

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def instant(moment_ns: int) -> datetime:
    """Return the instant, to the microsecond, of nanoseconds since 1970."""
    return EPOCH + timedelta(microseconds=moment_ns // 1000)


Instant = Annotated[datetime, BeforeValidator(lambda value: instant(value) if type(value) is int else value)]
"""A moment, also given in nanoseconds since 1970."""


def instant_or_none(moment_ns: int | None) -> datetime | None:
    return None if moment_ns is None else instant(moment_ns)


def coded(check: Callable[[str], str]) -> Callable[[str], str]:
    """Return the check as a validator whose refusal keeps its own code among the errors of the request."""

    def checked(value: str) -> str:
        try:
            return check(value)
        except StoneError as error:
            raise PydanticCustomError(error.code, "{sentence}", {"sentence": str(error)}) from None

    return checked


class Body(BaseModel):
    """A request body; unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def _attribute_of(field: str) -> str:
    return f"{field.removesuffix('_at')}_ns" if field == "at" or field.endswith("_at") else field


def _read_from(field: str) -> AliasChoices | str:
    attribute = _attribute_of(field)
    return field if attribute == field else AliasChoices(attribute, field)


class Answer(BaseModel):
    """A response; its fields are read from a value's attributes of the same names, `<name>_at` from `<name>_ns`.

    A field with other attributes has its own `validation_alias`. A response contains what its class names and nothing
    else of a value. Give `of` every field that the caller may not see as it is.
    """

    model_config = ConfigDict(
        frozen=True, from_attributes=True, alias_generator=AliasGenerator(validation_alias=_read_from)
    )

    @classmethod
    def of(cls, value: object, **given: Any) -> Self:
        """Return the response with the given fields, and the others from attributes of the value."""
        if not given:
            return cls.model_validate(value)
        for field, name in _attributes_of(cls):
            if field not in given:
                try:
                    given[field] = getattr(value, name)
                except AttributeError:
                    given[field] = getattr(value, field)
        return cls.model_validate(given)

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        """Complete the example of the class: fields of its base, ids, hashes, moments, other responses, null."""
        shown, inherited = example_of(cls), example_of(cls.__base__)
        if shown is not inherited:
            for name, field in cls.model_fields.items():
                if name not in shown:
                    shown[name] = inherited[name] if name in inherited else _usual_example(name, field.annotation)


@cache
def _attributes_of(answer: type[Answer]) -> tuple[tuple[str, str], ...]:
    aliases = {name: field.validation_alias for name, field in answer.model_fields.items()}
    choices = {name: alias.choices for name, alias in aliases.items() if isinstance(alias, AliasChoices)}
    return tuple((name, str(choices.get(name, [name])[0])) for name in aliases)


def example(**values: Any) -> ConfigDict:
    """Return the model's configuration with its example for the OpenAPI document."""
    return ConfigDict(json_schema_extra={"examples": [values]})


def example_of(model: Any) -> dict[str, Any]:
    """Return the example of the model; empty if it has none."""
    values: dict[str, Any] = getattr(model, "model_config", {}).get("json_schema_extra", _NO_EXAMPLES)["examples"][0]
    return values


_NO_EXAMPLES: dict[str, Any] = {"examples": [{}]}


def _usual_example(name: str, kind: Any) -> Any:
    """Return the example of a field that the model's own does not name. Raises `KeyError` if the type implies none."""
    if name == "id" or name.endswith("_id"):
        return ID_EXAMPLE
    if name.endswith("sha256"):
        return SHA256_EXAMPLE
    kinds = get_args(kind) or (kind,)
    if shown := example_of(kinds[0]):
        return [shown] if get_origin(kind) is list else shown
    return None if NoneType in kinds else {datetime: MADE}[kind]
