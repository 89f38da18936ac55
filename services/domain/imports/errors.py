"""Errors of importing a dataset."""

from collections.abc import Sequence

from stone.errors import Refused

SHOWN = 5


def existing_sequences(names: Sequence[str]) -> Refused:
    return Refused(
        "sequences_exist",
        f"{len(names)} scenes have the names of existing sequences: {_shown(names)}; delete or rename these "
        "sequences, or add the scenes' labels to them with existing: add (`stone dataset import --add-to-existing`)",
    )


def _shown(names: Sequence[str]) -> str:
    """Return the first names, shortened, and the number of further names."""
    return ", ".join(name[:100] for name in names[:SHOWN]) + (", …" if len(names) > SHOWN else "")
