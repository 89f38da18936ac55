"""The export formats that a user can choose for a sequence."""

from collections.abc import Iterable
from dataclasses import dataclass

from api.schemas.sequences.exports import ExportItem


@dataclass(frozen=True)
class Offer:
    """One format: its name and purpose."""

    format: str
    title: str
    purpose: str


OFFERS: tuple[Offer, ...] = (
    Offer("nuscenes", "nuScenes", "Frames, sensors and label grids as the nuScenes devkit reads them."),
    Offer("inputs", "Model inputs", "Sweeps and images of each frame, without labels."),
    Offer("kitti", "KITTI", "SemanticKITTI folders: velodyne, labels and poses."),
    Offer("mesh", "Mesh", "The reconstructed surface by class, as PLY and glTF."),
    Offer("mcap", "MCAP", "Labels beside the recording, for Foxglove."),
    Offer("rrd", "Rerun", "A recording for the Rerun viewer."),
    Offer("previews", "Previews", "Images of every frame and a video of the run."),
)
TITLES = {offer.format: offer.title for offer in OFFERS}


def offers_beside(exports: Iterable[ExportItem]) -> tuple[Offer, ...]:
    """Return the formats that the active labels are neither exported to nor being exported to."""
    standing = {
        export.format for export in exports if not export.is_stale and export.state not in ("failed", "cancelled")
    }
    return tuple(offer for offer in OFFERS if offer.format not in standing)
