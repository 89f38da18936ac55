"""A sequence of the server, its labels and its exports."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any

from stone_base.errors import Refused
from stone_client.api import Api
from stone_client.files.label_download import download_labels
from stone_client.progress import Report
from stone_client.sdk.labels import Labels
from stone_client.sdk.records import Item, LabelSet, record_of
from stone_client.sdk.runs import Run
from stone_client.sdk.tables import Table
from stone_client.server import exports, label_sets
from stone_client.server.job_following import follow
from stone_client.server.sequences import find_sequence, recordings_named, start_run
from stone_files.grid_file import chosen_grid


@dataclass(frozen=True)
class Connection:
    """The server of a record, and the progress function."""

    api: Api
    progress: Report


@dataclass(frozen=True)
class Sequence:
    """A sequence at the time of reading: `stone.sequence(name)` reads it again."""

    id: str
    name: str
    environment: str
    illumination: str
    region: str
    is_public: bool
    recordings: int
    duration_s: float | None
    distance_m: float | None
    record: Item = field(repr=False, compare=False)
    _at: Connection = field(repr=False, compare=False)

    @property
    def is_labelled(self) -> bool:
        """Whether it has an active label set."""
        return self.record.get("labels") is not None

    def process(
        self,
        *,
        profile: str = "field",
        parameters: Mapping[str, float] | None = None,
        grid: str | None = None,
        recordings: tuple[str, ...] = (),
        **options: Any,
    ) -> Run:
        """Label every frame, as `stone sequence process` does; a repeated request returns the same run.

        `profile` is field, local or paper; `grid` a name or a file. `options` are further fields of the request, such
        as `odometry_topic`.
        """
        body: dict[str, Any] = {"profile": profile, **options}
        body |= {"parameters": dict(parameters)} if parameters else {}
        body |= {"grid": chosen_grid(grid).as_record()} if grid else {}
        body |= {"recording_ids": recordings_named(self._at.api, self.record, recordings)} if recordings else {}
        return Run(self._at.api, start_run(self._at.api, self.record, body), self._at.progress)

    def labels(self, folder: str | Path | None = None) -> Labels:
        """Download the labels of every frame. Raises `no_labels`, `output_exists`.

        They are written to `folder` in the layout of `stone sequence download` (default: a temporary folder).
        """
        output = Path(folder) if folder is not None else Path(mkdtemp(prefix="stone-labels-"))
        try:
            download_labels(self._at.api, self._fresh(), output, self._at.progress)
            frames = self._at.api.pages(f"/sequences/{self.id}/frames")
            stamps_ns = {frame["token"]: int(frame["stamp_ns"]) for frame in frames}
            return Labels(output, stamps_ns, is_temporary=folder is None)
        except BaseException:
            if folder is None:
                rmtree(output, ignore_errors=True)
            raise

    def label_sets(self) -> Table[LabelSet]:
        """Return its label sets, newest first."""
        listed = label_sets.label_sets_of(self._at.api, self.id)
        return Table(LabelSet, (record_of(LabelSet, item) for item in listed))

    def exports(self) -> Table[Export]:
        """Return its exports, newest first."""
        listed = exports.exports_of(self._at.api, self.record)
        return Table(Export, (record_of(Export, item, _at=self._at) for item in listed))

    def export(self, format: str) -> Export:
        """Request its labels in a common format, such as nuscenes, kitti, mesh, mcap or rrd.

        An existing export is reused; `wait()` returns it when its files are ready.
        """
        accepted = self._at.api.create(f"/sequences/{self.id}/exports", {"format": format})
        return record_of(Export, accepted["export"], _at=self._at)

    def _fresh(self) -> Item:
        return find_sequence(self._at.api, self.id)


@dataclass(frozen=True)
class Export:
    """An export of a sequence's labels. `is_stale`: another label set is active by now."""

    id: str
    format: str
    state: str
    is_stale: bool
    files: int
    size_bytes: int
    record: Item = field(repr=False, compare=False)
    _at: Connection = field(repr=False, compare=False)

    def wait(self) -> Export:
        """Return the finished export. Raises `JobFailedError`."""
        follow(self._at.api, str(self.record["job_id"]), self._at.progress)
        own = f"/sequences/{self.record['sequence_id']}/exports/{self.id}"
        return record_of(Export, self._at.api.read(own), _at=self._at)

    def download(self, output: str | Path) -> Path:
        """Download all its files as a `.tar` or `.zip`; an interrupted download resumes. Raises `bad_archive_name`."""
        path = Path(output)
        if path.suffix[1:] not in exports.ARCHIVES:
            raise Refused("bad_archive_name", f"{path} is neither a .tar nor a .zip file; use one of these endings")
        finished = self if self.record.get("archives") else self.wait()
        exports.download_archive(self._at.api, finished.record, path, self._at.progress)
        return path
