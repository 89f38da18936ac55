"""What a result was made from and how, as one hash: equal recipes give equal results, so none is cooked twice."""

import json
from collections.abc import Mapping
from hashlib import sha256
from importlib.metadata import version
from typing import Any

CODE_VERSION = version("stone-platform")


def recipe_of(ingredients: Mapping[str, Any]) -> str:
    """sha256 of the ingredients (plain JSON values) and of the code version, in one spelling."""
    spelled = json.dumps({**ingredients, "code_version": CODE_VERSION}, sort_keys=True, separators=(",", ":"))
    return sha256(spelled.encode()).hexdigest()
