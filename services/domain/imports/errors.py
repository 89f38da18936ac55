"""Why a dataset is not imported."""

from collections.abc import Sequence

from stone.errors import StoneError

SHOWN = 5


class SplitsForbiddenError(StoneError):
    """The draft splits are the administrators'."""

    code = "splits_forbidden"

    def __init__(self) -> None:
        super().__init__("the draft splits are set by administrators alone; import without setting splits")


class ExistingSequencesError(StoneError):
    """Scenes are called as sequences that the owner has already."""

    code = "sequences_exist"

    def __init__(self, names: Sequence[str]) -> None:
        super().__init__(
            f"{len(names)} scenes are called as sequences that are there: {_shown(names)}; delete or rename those, or "
            "import with existing: add, and each gets the labels of its scene beside its own"
        )


class UnlabelledScenesError(StoneError):
    """Scenes of the dataset have frames without labels."""

    code = "scenes_unlabelled"

    def __init__(self, names: Sequence[str]) -> None:
        super().__init__(
            f"{len(names)} scenes have no labels in gts/, or not of every frame: {_shown(names)}; what has no labels "
            "is no label set: upload its recording instead, or leave these scenes out of the tables"
        )


def _shown(names: Sequence[str]) -> str:
    """The first names, and that there are more; each is cut."""
    return ", ".join(name[:100] for name in names[:SHOWN]) + (", …" if len(names) > SHOWN else "")
