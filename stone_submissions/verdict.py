"""Validation problems of a submission: a code per file and frame, the first hundred and the total.

**Conventions.** `ok` is true exactly if `errors_total` is 0. External texts are cut to 200 characters; unprintable
characters (terminal commands, text direction marks) are escaped.
"""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from stone_base.errors import StoneError, one_line
from stone_submissions.errors import SubmissionError

SHOWN = 100
LONGEST_TEXT = 200


@dataclass(frozen=True)
class ValidationProblem:
    """One problem: `file` is the name in the archive, `frame` its token, if it has one."""

    code: str
    file: str
    frame: str | None
    expected: str
    actual: str

    def as_record(self) -> dict[str, str | None]:
        return asdict(self)

    def __str__(self) -> str:
        return f"{self.code}: {self.file}: expected {self.expected}, found {self.actual}"


@dataclass(frozen=True)
class Validation:
    """The verdict on a submission: at most `SHOWN` problems, and the total number."""

    ok: bool
    errors: tuple[ValidationProblem, ...]
    errors_total: int

    def as_record(self) -> dict[str, object]:
        errors = [problem.as_record() for problem in self.errors]
        return {"ok": self.ok, "errors": errors, "errors_total": self.errors_total}


class SubmissionRefusedError(StoneError):
    """A submission is invalid and not scored; `validation` lists its problems."""

    code = "submission_refused"

    def __init__(self, validation: Validation) -> None:
        self.validation = validation
        super().__init__(f"the submission has {validation.errors_total} problems; the first is {validation.errors[0]}")


def problem_of(error: SubmissionError, file: str, frame: str | None) -> ValidationProblem:
    texts = (file, error.expected, error.actual)
    file, expected, actual = (one_line(text[:LONGEST_TEXT])[:LONGEST_TEXT] for text in texts)
    return ValidationProblem(error.code, file, frame, expected, actual)


def verdict(problems: Iterable[ValidationProblem]) -> Validation:
    listed = tuple(problems)
    return Validation(not listed, listed[:SHOWN], len(listed))


def validation_of(record: Mapping[str, Any]) -> Validation:
    """Return the validation in a record of `Validation.as_record`, cut to its limits because its writer is not trusted.

    Raises `KeyError`, `TypeError`, `ValueError` for other records.
    """
    errors = tuple(_problem(problem) for problem in record["errors"][:SHOWN])
    total = int(record["errors_total"])
    if total < len(errors) or (total > 0) != bool(errors):
        raise ValueError(f"{len(errors)} problems listed, but {total} counted")
    return Validation(total == 0, errors, total)


def merged(validations: Iterable[Validation]) -> Validation:
    """Return the verdicts on consecutive ranges as one verdict."""
    given = list(validations)
    total = sum(validation.errors_total for validation in given)
    return Validation(
        total == 0, tuple(problem for validation in given for problem in validation.errors)[:SHOWN], total
    )


def _problem(record: Mapping[str, Any]) -> ValidationProblem:
    code, file, expected, actual = (str(record[name])[:LONGEST_TEXT] for name in ("code", "file", "expected", "actual"))
    frame = None if record["frame"] is None else str(record["frame"])[:LONGEST_TEXT]
    return ValidationProblem(code, file, frame, expected, actual)
