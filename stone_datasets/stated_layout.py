"""The layout and grid that the user states for a dataset, and the resulting layout.

**Conventions.** Stated values take precedence over recognised ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from stone_base.label_grid import LabelGrid, grid_of
from stone_datasets.faults import DatasetFaultError, DatasetPlace
from stone_datasets.files import DatasetFiles
from stone_datasets.index import DatasetSequence
from stone_datasets.labels import layout_of_labels
from stone_files.dataset_layouts import DASHED_TOKEN, DatasetLayout, named_layout

MOST_TRIED = 8


@dataclass(frozen=True)
class StatedLayout:
    """The name of a layout of `LAYOUTS`, and a grid; None if not stated."""

    layout: str | None = None
    grid: LabelGrid | None = None

    def of(self, files: DatasetFiles, sequences: Sequence[DatasetSequence]) -> DatasetLayout:
        """Return the layout of these sequences: as stated, otherwise from their first label file and their tokens.

        Raises `bad_layout`.
        """
        layout = _recognised(files, sequences) if self.layout is None else named_layout(self.layout)
        return layout if self.grid is None else layout.with_grid(self.grid)

    def as_record(self) -> dict[str, Any] | None:
        """Return the stated values as JSON, or None if there are none."""
        grid = None if self.grid is None else self.grid.as_record()
        return None if self == UNSTATED else {"layout": self.layout, "grid": grid}

    @classmethod
    def of_record(cls, record: Mapping[str, Any] | None) -> "StatedLayout":
        """Return the stated layout in a record of `as_record`. Raises `bad_grid`."""
        if record is None:
            return cls()
        return cls(record["layout"], None if record["grid"] is None else grid_of(record["grid"]))


UNSTATED = StatedLayout()


def form_of_tokens(written: Sequence[str], position: DatasetPlace) -> bool:
    """Return whether these frame tokens are UUIDs with dashes. Raises `DST-043` if only some have dashes."""
    is_dashed = [DASHED_TOKEN.fullmatch(token) is not None for token in written]
    if len(set(is_dashed)) > 1:
        first = written[is_dashed.index(not is_dashed[0])]
        what = f"{sum(is_dashed)} of {len(written)} frame tokens have dashes; {first} differs from {written[0]}"
        raise DatasetFaultError("DST-043", position, what)
    return any(is_dashed)


def _recognised(files: DatasetFiles, sequences: Sequence[DatasetSequence]) -> DatasetLayout:
    has_dashes = any(sequence.has_dashes for sequence in sequences)
    labelled = next((sequence for sequence in sequences if sequence.is_labelled), None)
    names = [] if labelled is None else [labelled.label_name(frame) for frame in range(min(len(labelled), MOST_TRIED))]
    spans = (span for name in names if (span := files.span(name)) is not None)
    return layout_of_labels(next(spans, None), has_dashes=has_dashes)
