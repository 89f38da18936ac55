"""Frames of a phase whose labels may be shown to everybody: which these are, and their label grids.

**Conventions.** Labels are read from train or val of the dataset version that the ground truth was made of
(`services/domain/datasets/queries.py`), which never locates test. Nothing is shown of a phase whose ground truth is
hidden, before or after its end, nor of a sequence whose labels any version or phase hides. A grid is (256, 256, 32)
uint8 in the ego frame, classes 0 to 3.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from services.domain.benchmarks.phases.evaluation_versions import active
from services.domain.benchmarks.visibility import secrecy_of
from services.domain.datasets.catalogue import hidden_truths
from services.domain.datasets.input_jobs import members_of
from services.domain.datasets.queries import locate_part, open_parts
from services.domain.viewer.frame_grids import SHOWN_GRIDS, read_grids
from services.runtime.orm import Dataset, DatasetMember, GroundTruthRow, Phase
from services.runtime.orm.base import now_ns
from services.runtime.store.pack_reading import ExportLocation, file_pieces, stored_files
from services.runtime.store.packs import PackedFiles
from services.runtime.store.protocol import Store
from stone_base.label_grid import PAPER, LabelGrid, recorded_grid

Grid = NDArray[np.uint8]
LABEL_FILE = re.compile(r"gts/([^/]+)/([^/]+)/labels\.npz")
HELD = 4


@dataclass(frozen=True)
class OpenTruth:
    """The place of the labels of an open ground truth, the names of its sequences that nothing hides, and its grid."""

    located: ExportLocation
    sequences: frozenset[str]
    grid: LabelGrid = PAPER


@dataclass(frozen=True, eq=False)
class OpenFrames:
    """The frames that may be shown: the sequence of each by its token, in the order of the dataset's files; the grid of
    all."""

    located: ExportLocation
    sequences: Mapping[str, str]
    grid: LabelGrid = PAPER


def open_truth_of(session: Session, phase: Phase) -> OpenTruth | None:
    """The ground truth in force, where its labels may be shown."""
    pair = active(session, phase.id)
    return locate_open_truth(session, phase, session.get_one(GroundTruthRow, pair.truth_id)) if pair else None


def locate_open_truth(session: Session, phase: Phase, truth: GroundTruthRow) -> OpenTruth | None:
    """Where to read the labels; None where the phase hides them, and where no version has the part to read from."""
    dataset = session.get_one(Dataset, truth.dataset_id)
    is_there = truth.part in {row.part for row in open_parts(session, dataset)}
    if secrecy_of(phase, now_ns()) != "open" or truth.phase_id != phase.id or not is_there:
        return None
    shown = members_of(dataset.id, [truth.part]).where(DatasetMember.sequence_id.not_in(hidden_truths()))
    names = frozenset(session.scalars(shown.with_only_columns(DatasetMember.name).order_by(None)))
    return OpenTruth(locate_part(session, dataset, truth.part)[1], names, recorded_grid(dataset.grid))


def open_frames(store: Store, found: OpenTruth) -> OpenFrames:
    """The frames; reads the index of the part, so not within a transaction."""
    places = _places(stored_files(store, found.located).files)
    shown = {token: name for token, (name, _) in places.items() if name in found.sequences}
    return OpenFrames(found.located, MappingProxyType(shown), found.grid)


def all_tokens(store: Store, located: ExportLocation) -> tuple[str, ...]:
    """All frames of the part, which are those that a submission must hold."""
    return tuple(_places(stored_files(store, located).files))


def truth_grids(store: Store, located: ExportLocation, token: str) -> tuple[Grid, Grid]:
    """The classes of a frame, and 1 where the LiDAR observed the voxel.

    Raises `KeyError` for a token that is none of the part's, `grid_unreadable`.
    """
    stored = stored_files(store, located)
    _, ordinal = _places(stored.files)[token]
    size_bytes = int(stored.files.sizes_bytes[ordinal])
    pieces = file_pieces(stored.files, ordinal, (0, size_bytes), stored.reader(store))
    semantics, observed = read_grids(b"".join(pieces), SHOWN_GRIDS)
    return semantics, observed


@lru_cache(maxsize=HELD)
def _places(files: PackedFiles) -> Mapping[str, tuple[str, int]]:
    """The sequence and the place of each frame's label file by its token; files are told apart as objects."""
    named = ((LABEL_FILE.fullmatch(name), place) for place, name in enumerate(files.names))
    return MappingProxyType({found[2]: (found[1], place) for found, place in named if found})
