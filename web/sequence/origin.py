"""The origin of labels that were not made here: the published dataset that they were imported from."""

from dataclasses import dataclass

from services.runtime.orm import LabelSet


@dataclass(frozen=True)
class LabelOrigin:
    """The dataset's name as its importer gave it, the sha256 of its tar, and the name of the class map, if any."""

    dataset: str
    sha256: str
    classes: str


def origin_of(labels: LabelSet | None) -> LabelOrigin | None:
    """None where there are no labels, or they were made of a recording."""
    said = {} if labels is None else labels.parameters
    if not said.get("dataset") or not said.get("sha256"):
        return None
    return LabelOrigin(str(said["dataset"]), str(said["sha256"]), str((said.get("classes") or {}).get("name", "")))
