"""Frames of a phase whose labels are public, and their label grids.

**Conventions.** Labels are read from train or val of the ground truth's dataset version
(`services/domain/datasets/queries.py`), never from test. No frames are shown of a phase with hidden ground truth, even
after its end, or of a sequence whose labels another version or phase hides. A grid is (256, 256, 32) uint8 in the ego
frame, classes 0 to 3.
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
    """An open ground truth: where its labels are, its sequences that are not hidden elsewhere, and its grid."""

    located: ExportLocation
    sequences: frozenset[str]
    grid: LabelGrid = PAPER


@dataclass(frozen=True, eq=False)
class OpenFrames:
    """The frames that may be shown: sequence by frame token, in the order of the dataset's files; their grid."""

    located: ExportLocation
    sequences: Mapping[str, str]
    grid: LabelGrid = PAPER


def open_truth_of(session: Session, phase: Phase) -> OpenTruth | None:
    """Return the active ground truth, or None if its labels must not be shown."""
    pair = active(session, phase.id)
    return locate_open_truth(session, phase, session.get_one(GroundTruthRow, pair.truth_id)) if pair else None


def locate_open_truth(session: Session, phase: Phase, truth: GroundTruthRow) -> OpenTruth | None:
    """Return the location of the labels; None if the phase hides them or no version has the part."""
    dataset = session.get_one(Dataset, truth.dataset_id)
    is_there = truth.part in {row.part for row in open_parts(session, dataset)}
    if secrecy_of(phase, now_ns()) != "open" or truth.phase_id != phase.id or not is_there:
        return None
    shown = members_of(dataset.id, [truth.part]).where(DatasetMember.sequence_id.not_in(hidden_truths()))
    names = frozenset(session.scalars(shown.with_only_columns(DatasetMember.name).order_by(None)))
    return OpenTruth(locate_part(session, dataset, truth.part)[1], names, recorded_grid(dataset.grid))


def open_frames(store: Store, truth: OpenTruth) -> OpenFrames:
    """Return the frames. Reads the part's index from the store: call it outside transactions."""
    places = _places(stored_files(store, truth.located).files)
    shown = {token: name for token, (name, _) in places.items() if name in truth.sequences}
    return OpenFrames(truth.located, MappingProxyType(shown), truth.grid)


def all_tokens(store: Store, located: ExportLocation) -> tuple[str, ...]:
    """Return all frame tokens of the part; a submission must contain exactly these."""
    return tuple(_places(stored_files(store, located).files))


def truth_grids(store: Store, located: ExportLocation, token: str) -> tuple[Grid, Grid]:
    """Return the classes of a frame, and a mask that is 1 for voxels observed by the LiDAR.

    Raises `KeyError` for a token outside the part, `grid_unreadable`.
    """
    stored = stored_files(store, located)
    _, ordinal = _places(stored.files)[token]
    size_bytes = int(stored.files.sizes_bytes[ordinal])
    pieces = file_pieces(stored.files, ordinal, (0, size_bytes), stored.reader(store))
    semantics, observed = read_grids(b"".join(pieces), SHOWN_GRIDS)
    return semantics, observed


@lru_cache(maxsize=HELD)
def _places(files: PackedFiles) -> Mapping[str, tuple[str, int]]:
    """Return sequence and path of each frame's label file by token, reading each shared object once."""
    named = ((LABEL_FILE.fullmatch(name), index) for index, name in enumerate(files.names))
    return MappingProxyType({match[2]: (match[1], index) for match, index in named if match})
