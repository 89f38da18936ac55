"""Recipes: hashes of inputs, parameters and code, so that equal work is done once."""

import json
from collections.abc import Mapping
from hashlib import sha256
from typing import Any

from services.runtime.code_version import code_version


def recipe_of(ingredients: Mapping[str, Any]) -> str:
    """sha256 of the ingredients (plain JSON values) and of the version of the code of labels, in one spelling."""
    spelled = json.dumps({**ingredients, "code_version": code_version("labels")}, sort_keys=True, separators=(",", ":"))
    return sha256(spelled.encode()).hexdigest()
