"""The sentence that describes each property and parameter of the API's document.

**Conventions.** One sentence per field name, in the words of the glossary, since a name means one thing everywhere; a
key `Schema.field` overrides it. A test refuses a name
without a sentence and a sentence without a name.
"""

from collections.abc import Mapping
from typing import Any

from api.words.benchmarks import BENCHMARKS
from api.words.jobs import JOBS
from api.words.narrower import NARROWER
from api.words.parameters import PARAMETERS as PARAMETERS
from api.words.people import PEOPLE
from api.words.sequences import SEQUENCES
from api.words.shared import SHARED

FIELDS: Mapping[str, str] = {**SHARED, **PEOPLE, **JOBS, **SEQUENCES, **BENCHMARKS, **NARROWER}
PAGE = "A page of a list."
FORM = "A form."


def describe(document: dict[str, Any]) -> None:
    """Give every schema, property and parameter of the document its sentence, unless it has one."""
    for name, schema in document["components"]["schemas"].items():
        schema.setdefault("description", PAGE if name.startswith("Page_") else FORM if name.startswith("Body_") else "")
        for field, value in schema.get("properties", {}).items():
            value.setdefault("description", FIELDS.get(f"{name}.{field}") or FIELDS.get(field, ""))
    for methods in document["paths"].values():
        for operation in methods.values():
            for parameter in operation.get("parameters", ()):
                parameter.setdefault("description", PARAMETERS.get(parameter["name"], ""))
