"""A version of the dataset on the server."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from stone_client.sdk.records import Item
from stone_client.sdk.sequences import Connection
from stone_client.server import datasets


@dataclass(frozen=True)
class DatasetVersion:
    """A version of the dataset; it never changes. `sizes` counts the sequences of each split."""

    name: str
    licence: str
    sizes: Item
    created_at: str
    record: Item = field(repr=False, compare=False)
    _at: Connection = field(repr=False, compare=False)

    def download(self, folder: str | Path, *, inputs: bool = False) -> list[Path]:
        """Download the manifest and the labels of train and val, with `inputs` also the sensor data; return the files.

        Existing files are not downloaded again; an interrupted download resumes.
        """
        api, progress, output = self._at.api, self._at.progress, Path(folder)
        whole = datasets.read_dataset(api, self.name)
        files = datasets.download_dataset(api, whole, output, progress)
        if inputs:
            files += datasets.download_dataset_inputs(api, whole, output, progress)
        return [Path(file["output"]) for file in files if "output" in file]
