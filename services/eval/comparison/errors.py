"""Why two label sets cannot be compared."""

from stone.errors import StoneError


class NothingInCommonError(StoneError):
    """The two label sets share no frame."""

    code = "nothing_in_common"

    def __init__(self, a: str, b: str, frames: tuple[int, int]) -> None:
        super().__init__(
            f"{a} ({frames[0]} frames) and {b} ({frames[1]} frames) share no frame token; tokens are made of the"
            " sequence's name and the stamp, so are these labels of one run, labelled under one name?"
        )
