"""A server as an object: `Stone`.

**Conventions.** A subject is a name or an id, as in the command; a submission may be `latest`, `latest~1`, ….
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from types import TracebackType

from stone_client.api import Api
from stone_client.baseline import BaselinePlan, write_baseline
from stone_client.credentials import Server, choose_server, plain_url
from stone_client.files.bags import bags_among, hashed_parts
from stone_client.files.datasets import dataset_name
from stone_client.progress import Report
from stone_client.sdk.datasets import DatasetVersion
from stone_client.sdk.labels import Labels
from stone_client.sdk.records import (
    Benchmark,
    Comparison,
    Item,
    LabelSet,
    Leaderboard,
    Phase,
    Upload,
    benchmark_of,
    comparison_of,
    leaderboard_of,
    record_of,
)
from stone_client.sdk.runs import Run
from stone_client.sdk.sequences import Connection, Export, Sequence
from stone_client.sdk.submissions import Submission
from stone_client.sdk.tables import Table
from stone_client.server import benchmarks, boards, datasets, scores, sequences, teams
from stone_client.server import dataset_imports as imports
from stone_client.server import submission as submitting
from stone_client.server.job_following import follow
from stone_client.server.label_sets import delete_label_set
from stone_client.server.places import place_named
from stone_files.grid_file import chosen_grid

StrPath = str | Path


def ignore_progress(_stage: str, _done: int, _total: int) -> None:
    """Do nothing: the default progress function."""


class Stone:
    """A server (default: the server of `stone auth login`, or of STONE_URL and STONE_TOKEN).

        with Stone() as stone:
            stone.sequences().to_pandas()

    `progress(stage, done, total)` is called as work proceeds.
    """

    def __init__(self, url: str = "", token: str = "", progress: Report = ignore_progress) -> None:
        self.api = Api(Server(plain_url(url), token) if url and token else choose_server(url or None))
        self._progress = progress
        self._at = Connection(self.api, progress)

    def __enter__(self) -> Stone:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections to the server."""
        self.api.__exit__(None, None, None)

    def __repr__(self) -> str:
        return f"<Stone {self.api.url}>"

    # Sequences

    def sequences(self, **filters: str) -> Table[Sequence]:
        """Return the sequences that you may see, newest first; `filters` are query parameters, such as `name`."""
        return Table(Sequence, map(self._sequence, self.api.pages("/sequences", **filters)))

    def sequence(self, sequence: str) -> Sequence:
        """Return a sequence by name or id. Raises `not_found`."""
        return self._sequence(sequences.find_sequence(self.api, sequence))

    def uploads(self) -> Table[Upload]:
        """Return your uploads in progress."""
        return Table(Upload, (record_of(Upload, item) for item in self.api.pages("/uploads")))

    def upload(self, *bags: StrPath, calibration: StrPath, name: str = "") -> Sequence:
        """Upload the recordings of a run and its calibration; return their sequence. A repeated call resumes.

        Files of one split bag are one recording; other files are separate recordings. Raises `file_changed`,
        `bad_recording_files`, and the code of a refused recording or calibration.
        """
        recordings = bags_among([Path(bag) for bag in bags])
        sequence = sequences.ensure_sequence(self.api, name or recordings[0].called)
        sequences.pin_calibration(self.api, sequence, Path(calibration))
        for bag in recordings:
            sequences.add_recording(self.api, sequence, hashed_parts(bag, self._progress), self._progress)
        return self.sequence(str(sequence["id"]))

    def process(self, sequence: str, *, profile: str = "field") -> Run:
        """Label every frame of a sequence; `Sequence.process` takes more options."""
        return self.sequence(sequence).process(profile=profile)

    def run(self, run: str) -> Run:
        """Return the job or run with this id, or the newest run of a sequence. Raises `not_found`."""
        return Run(self.api, sequences.find_job(self.api, run), self._progress)

    def labels(self, sequence: str, folder: StrPath | None = None) -> Labels:
        """Download the labels of a sequence as NumPy arrays; see `Sequence.labels`. Raises `not_found`, `no_labels`."""
        return self.sequence(sequence).labels(folder)

    def exports(self, sequence: str) -> Table[Export]:
        """Return the exports of a sequence, newest first. `Sequence.export` requests one."""
        return self.sequence(sequence).exports()

    def label_sets(self, sequence: str) -> Table[LabelSet]:
        """Return the label sets of a sequence, newest first.

        `record` has `held_out_recall` over `held_out_m` metres of track, and the `gravest` finding.
        """
        return self.sequence(sequence).label_sets()

    def delete_label_set(self, sequence: str, label_set: str) -> str:
        """Delete a label set (id, latest, latest~1, …) of a sequence, free its storage and return its id.

        Raises `label_set_pinned` if an export, a version, a phase, the draft splits or a public sequence uses it.
        """
        return delete_label_set(self.api, sequences.find_sequence(self.api, sequence), label_set)

    # The dataset

    def datasets(self) -> Table[DatasetVersion]:
        """Return the versions of the dataset, newest first."""
        return Table(DatasetVersion, map(self._dataset, datasets.read_datasets(self.api)))

    def dataset(self, version: str) -> DatasetVersion:
        """Return a version of the dataset. Raises `not_found`."""
        return self._dataset(datasets.read_dataset(self.api, version))

    def import_dataset(
        self,
        path: StrPath,
        *,
        in_place: bool = False,
        name: str = "",
        classes: StrPath | None = None,
        layout: str | None = None,
        grid: str | None = None,
        add_to_existing: bool = False,
        set_splits: bool = False,
        is_public: bool = False,
    ) -> Item:
        """Upload a published dataset in a folder, tar or ZIP; return its import after every scene has become a
        sequence.

        With `in_place` the server reads the archive at `path`, a ROOT:PATH, in place. `grid` is a name or a file.
        Raises a `DatasetFaultError` for a wrong layout, `JobFailedError` with the code of the server's finding.
        """
        stated_classes = None if classes is None else Path(classes).read_text("utf-8")
        existing = "add" if add_to_existing else "refuse"
        stated_grid = chosen_grid(grid).as_record() if grid else None
        server_place = place_named(str(path), with_pictures=False) if in_place else None
        called = name or dataset_name(Path(server_place.path if server_place else path))
        wishes = imports.DatasetWishes(called, stated_classes, existing, set_splits, is_public, layout, stated_grid)
        if server_place is not None:
            begun = imports.import_in_place(self.api, server_place, wishes)
        else:
            begun = imports.send_dataset(self.api, Path(path), wishes, self._progress)
        follow(self.api, begun["job_id"], self._progress)
        return imports.read_import(self.api, begun["id"])

    # Benchmarks

    def benchmarks(self) -> Table[Benchmark]:
        """Return the benchmarks with their phases, newest first."""
        return Table(Benchmark, map(benchmark_of, benchmarks.read_benchmarks(self.api)))

    def benchmark(self, name: str) -> Benchmark:
        """Return a benchmark with its phases. Raises `not_found`."""
        return benchmark_of(benchmarks.read_benchmark(self.api, name))

    def phase(self, benchmark: str, phase: str) -> Phase:
        """Return a phase; `record` has its rules and dates. Raises `not_found`."""
        return record_of(Phase, benchmarks.read_phase(self.api, benchmark, phase))

    def manifest(self, benchmark: str, phase: str, output: StrPath) -> Path:
        """Write the list of frames to predict."""
        return Path(benchmarks.fetch_manifest(self.api, (benchmark, phase), Path(output))["output"])

    def inputs(self, benchmark: str, phase: str, folder: StrPath) -> list[Path]:
        """Download the sensor data of a phase: a tar for each sequence; existing files are kept."""
        files = benchmarks.download_inputs(self.api, (benchmark, phase), Path(folder), self._progress)
        return [Path(file["output"]) for file in files]

    def baseline(self, sources: Iterable[StrPath], manifest: StrPath, output: StrPath) -> Path:
        """Write the geometric baseline's predictions for the frames of a manifest, as `stone baseline` does."""
        from stone_client.options import cores

        plan = BaselinePlan(Path(manifest), Path(output), cores())
        return Path(write_baseline([Path(source) for source in sources], plan, self._progress).output)

    def leaderboard(self, benchmark: str, phase: str, track: str = "all", as_of: str = "") -> Leaderboard:
        """Return the board, at present or at a time such as 2026-06-01T00:00:00Z."""
        return leaderboard_of(boards.read_board(self.api, boards.BoardSelection(benchmark, phase, track, as_of)))

    # Submissions

    def submissions(self) -> list[Submission]:
        """Return the submissions of your teams, newest first."""
        return [Submission(self.api, item, self._progress) for item in scores.read_submissions(self.api)]

    def submission(self, submission: str) -> Submission:
        """Return a submission by id, or `latest`, `latest~1`, …. Raises `no_submission`, `not_found`."""
        named = scores.submission_id(self.api, submission)
        return Submission(self.api, self.api.read(f"/submissions/{named}"), self._progress)

    def submit(
        self,
        path: StrPath,
        *,
        benchmark: str,
        phase: str,
        team: str,
        method: str,
        modality: str,
        description: str = "",
        kind: str = "entry",
    ) -> Submission:
        """Submit a zip of predictions; `kind` is entry, validation (only checked) or baseline (for organisers).

        A started submission of the same file continues; it is never sent twice.
        """
        phase_id = str(self.phase(benchmark, phase).record["id"])
        at = (phase_id, str(teams.find_team(self.api, team)["id"]))
        entry = submitting.SubmissionDescription(*at, method, modality, description, kind)
        return Submission(self.api, submitting.submit(self.api, Path(path), entry, self._progress), self._progress)

    def compare(self, a: str, b: str) -> Comparison:
        """Return the differences of two submissions to one phase, and whether they are significant."""
        named = (scores.submission_id(self.api, named_id) for named_id in (a, b))
        return comparison_of(scores.compare(self.api, *named))

    def _sequence(self, item: Item) -> Sequence:
        return record_of(Sequence, item, _at=self._at)

    def _dataset(self, item: Item) -> DatasetVersion:
        return record_of(DatasetVersion, item, _at=self._at)
