"""What a sandboxed child may answer, as strict models of JSON.

**Conventions.** A child may be in the hands of whoever wrote what it reads: nothing is taken that was not asked for,
and what does not fit ends the child's job (`SandboxCrashedError`).
"""

from typing import Annotated, ClassVar, Self

from pydantic import BaseModel, ConfigDict, StringConstraints, ValidationError

from services.runtime.sandbox.errors import SandboxCrashedError

Hex256 = Annotated[str, StringConstraints(pattern=r"\A[0-9a-f]{64}\z")]


class SandboxAnswer(BaseModel):
    """One answer."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)
    expected: ClassVar[str]

    def packed(self) -> bytes:
        return self.model_dump_json().encode()

    @classmethod
    def believed(cls, answer: bytes) -> Self:
        """Raises `SandboxCrashedError`."""
        try:
            return cls.model_validate_json(answer)
        except (ValidationError, RecursionError) as error:
            raise SandboxCrashedError(f"answered something else than {cls.expected}") from error
