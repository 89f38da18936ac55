"""Answers filled from a row: fields of the same name are copied, so that a new column is shown by naming it once."""

from typing import Any

from api.schemas.base import Answer, instant_or_none
from services.runtime.orm import Base


def shown_columns(row: Base, answer: type[Answer]) -> dict[str, Any]:
    """Those fields of the answer that are columns of the row; `<name>_at` is the instant of `<name>_ns`.

    A column that the answer does not name is not shown.
    """
    columns = row.__table__.columns.keys()
    shown = {name: getattr(row, name) for name in answer.model_fields if name in columns}
    instants = {name: f"{name.removesuffix('_at')}_ns" for name in answer.model_fields if name.endswith("_at")}
    return shown | {name: instant_or_none(getattr(row, ns)) for name, ns in instants.items() if ns in columns}
