"""The formats that a sequence's labels are exported in, as people choose among them."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Offer:
    """One format: what it is called, and what it is for."""

    format: str
    title: str
    purpose: str


OFFERS = (
    Offer("nuscenes", "nuScenes", "Frames, sensors and label grids as the nuScenes devkit reads them."),
    Offer("inputs", "Model inputs", "Sweeps and pictures of each frame, without labels: what a method is given."),
    Offer("kitti", "KITTI", "SemanticKITTI folders: velodyne, labels and poses."),
    Offer("mesh", "Mesh", "The reconstructed surface by class, as PLY and glTF."),
    Offer("mcap", "MCAP", "Labels beside the recording, for Foxglove."),
    Offer("rrd", "Rerun", "A recording for the Rerun viewer."),
    Offer("previews", "Pictures and film", "Pictures of every frame and a film of the drive."),
)
