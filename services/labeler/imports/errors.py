"""What is refused of what an index left of a scene."""

from stone.errors import StoneError


class SceneDamagedError(StoneError):
    """What the index of a dataset left of a scene, or the tar that it is of, is not what it was."""

    code = "scene_damaged"

    def __init__(self, what: str) -> None:
        super().__init__(f"{what[:200]}: was the dataset, or what its index left, changed? import it again")
