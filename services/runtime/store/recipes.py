"""Recipes: hashes of inputs, parameters and code, so that equal work is done once."""

import json
from collections.abc import Mapping
from hashlib import sha256
from typing import Any

from services.runtime.code_version import code_version
from services.runtime.source_digests import ResultKind


def recipe_of(kind: ResultKind, ingredients: Mapping[str, Any]) -> str:
    """Return the sha256 of the ingredients (plain JSON values) and of the code version of this kind of result."""
    spelled = json.dumps({**ingredients, "code_version": code_version(kind)}, sort_keys=True, separators=(",", ":"))
    return sha256(spelled.encode()).hexdigest()
