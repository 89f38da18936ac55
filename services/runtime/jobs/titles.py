"""Titles of runs and jobs for people, by kind.

**Conventions.** A title says what is done, in the words of the glossary. Stages of one run stand in the order in which
they begin. Of a kind that is not here the kind is shown.
"""

from collections.abc import Mapping

TITLES: Mapping[str, str] = {
    "sequence.process": "Labelling",
    "ingest.register": "Read the recording",
    "ingest.synchronise": "Synchronise sensors",
    "ingest.check": "Check cameras and clocks",
    "labeler.parts": "Plan the map",
    "labeler.fuse": "Fuse sweeps",
    "labeler.surface": "Reconstruct the surface",
    "labeler.sight": "Free-space carving",
    "labeler.reference": "Reference terrain model",
    "labeler.frames": "Label frames",
    "labeler.map": "Render the map",
    "labeler.pictures": "Draw pictures of the map",
    "labeler.publish": "Publish",
    "labeler.export": "Write the export",
    "eval.compare": "Compare label sets",
    "dataset.import": "Importing a dataset",
    "ingest.keep_dataset": "Store the dataset",
    "labeler.import_index": "Read the dataset's tables",
    "labeler.import_scene": "Import scenes",
    "labeler.import_publish": "Publish the dataset",
    "dataset.inputs": "Inputs of a dataset version",
    "phase.inputs": "Inputs of a phase",
    "labeler.inputs": "Write inputs",
    "score": "Scoring a submission",
    "phase.rescore": "Re-scoring a phase",
    "eval.open": "Validate the file",
    "eval.part": "Count voxels",
    "eval.join": "Compute scores",
    "eval.truth": "Build the ground truth",
    "notify.deliver": "Deliver a notification",
}


def title_of(kind: str) -> str:
    """The title of jobs of this kind."""
    return TITLES.get(kind, kind)
