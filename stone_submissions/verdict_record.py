"""The record of a validation, read back from rows and from other processes, and added up."""

from collections.abc import Iterable, Mapping
from typing import Any

from stone_submissions.verdict import LONGEST_TEXT, SHOWN, Validation, ValidationProblem


def validation_of(record: Mapping[str, Any]) -> Validation:
    """What `Validation.as_record` wrote, cut to its bounds whoever wrote it.

    Raises `KeyError`, `TypeError`, `ValueError` for anything else.
    """
    errors = tuple(_problem(one) for one in record["errors"][:SHOWN])
    total = int(record["errors_total"])
    if total < len(errors) or (total > 0) != bool(errors):
        raise ValueError(f"{len(errors)} problems are shown of {total}")
    return Validation(total == 0, errors, total)


def merged(validations: Iterable[Validation]) -> Validation:
    """The verdicts on ranges as one on them all, in their order."""
    given = list(validations)
    total = sum(one.errors_total for one in given)
    return Validation(total == 0, tuple(problem for one in given for problem in one.errors)[:SHOWN], total)


def _problem(record: Mapping[str, Any]) -> ValidationProblem:
    code, file, expected, actual = (str(record[name])[:LONGEST_TEXT] for name in ("code", "file", "expected", "actual"))
    frame = None if record["frame"] is None else str(record["frame"])[:LONGEST_TEXT]
    return ValidationProblem(code, file, frame, expected, actual)
