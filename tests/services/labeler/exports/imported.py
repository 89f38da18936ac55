"""The drive as it comes back: its own nuScenes export, imported again without a platform."""

from dataclasses import dataclass
from pathlib import Path

from services.domain.sequences.label_sources import SOURCE, SOURCE_INDEX
from services.labeler.child_answers import PublicationAnswer
from services.labeler.exports.dataset_source import DatasetSource
from services.labeler.exports.nuscenes.layout import write_nuscenes
from services.labeler.exports.sandboxed_export import ExportInputs, LabelRange, PackedLabels
from services.labeler.exports.source import LabelledSequence
from testing.worlds.imported import artefacts_of, write_import
from tests.services.labeler.exports.made import unheard


@dataclass(frozen=True)
class Imported:
    """A dataset of one scene in the folder `published`, and what an import of it leaves in `artefacts`."""

    published: Path
    artefacts: Path
    source: DatasetSource
    inputs: ExportInputs

    @property
    def labelled(self) -> LabelledSequence:
        return self.inputs.opened()


def again(labelled: LabelledSequence, root: Path) -> Imported:
    """A labelled sequence exported and imported."""
    published = root / "published"
    published.mkdir(parents=True)
    write_nuscenes(labelled, published, unheard)
    return imported(published, root / "imported")


def imported(published: Path, out: Path) -> Imported:
    """The dataset of one scene in a folder, imported into another."""
    (told,) = write_import(published, out)
    artefacts = artefacts_of(out)
    index, packs = artefacts / SOURCE_INDEX, sorted((artefacts / SOURCE).glob("*.pack"))
    source = DatasetSource(index, tuple(packs))
    return Imported(published, artefacts, source, ExportInputs(artefacts, _labels(told, artefacts), source=source))


def _labels(told: PublicationAnswer, artefacts: Path) -> PackedLabels:
    packs = {pack.name: artefacts / pack.name.replace("packs/", "labels/") for pack in told.packs}
    ranges = [
        LabelRange(told.tokens[pack.first + place], pack.name, *found)
        for pack in told.packs
        for place, found in enumerate(pack.ranges)
    ]
    return PackedLabels(packs, tuple(ranges))
