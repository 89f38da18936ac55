"""How work on hostile bytes ended, when it did not end with an answer or a refusal of its own."""

from services.runtime.errors import PlatformFaultError
from stone.errors import StoneError


class ConfinedCrashedError(StoneError):
    """Reading the input broke its process or its limits; the same bytes would do so again."""

    code = "reader_crashed"

    def __init__(self, fate: str) -> None:
        self.fate = fate
        super().__init__(f"the process that read the input {fate}; is the file damaged, or made to do this?")


class ConfinedInterruptedError(PlatformFaultError):
    """Reading the input was cut short by the machine; perhaps no fault of the input."""

    code = "reader_interrupted"

    def __init__(self, fate: str) -> None:
        self.fate = fate
        super().__init__(f"the process that read the input {fate}; it is tried again")
