"""Answers of sandboxed children, as strict models of JSON.

**Conventions.** The author of the input may control the child. Only requested data are accepted, and an invalid answer
ends the child's job (`SandboxCrashedError`).
"""

from typing import Annotated, ClassVar, Self

from pydantic import BaseModel, ConfigDict, StringConstraints, ValidationError

from services.runtime.sandbox.errors import SandboxCrashedError

Hex256 = Annotated[str, StringConstraints(pattern=r"\A[0-9a-f]{64}\z")]


class SandboxAnswer(BaseModel):
    """An answer of a child."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)
    expected: ClassVar[str]

    def packed(self) -> bytes:
        return self.model_dump_json().encode()

    @classmethod
    def believed(cls, answer: bytes) -> Self:
        """Return the validated answer. Raises `SandboxCrashedError`."""
        try:
            return cls.model_validate_json(answer)
        except (ValidationError, RecursionError) as error:
            raise SandboxCrashedError(f"answered something else than {cls.expected}") from error
