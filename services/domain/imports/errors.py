"""Why a dataset is not imported."""

from collections.abc import Sequence

from stone.errors import Refused

SHOWN = 5


def existing_sequences(names: Sequence[str]) -> Refused:
    return Refused(
        "sequences_exist",
        f"{len(names)} scenes are called as sequences that are there: {_shown(names)}; delete or rename those, or "
        "import with existing: add (`stone dataset import --add-to-existing`): each gets its labels beside "
        "its own",
    )


def _shown(names: Sequence[str]) -> str:
    """The first names, and that there are more; each is cut."""
    return ", ".join(name[:100] for name in names[:SHOWN]) + (", …" if len(names) > SHOWN else "")
