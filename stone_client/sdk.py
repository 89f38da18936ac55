"""The platform from Python, for participants: the same functions as the `stone` command, without the printing.

    from stone_client.sdk import Stone

    with Stone("https://stone.example.org", token) as stone:
        submission = stone.submit(
            "sub.zip", benchmark="stone", phase="test", team="Terrain Gang", method="GroundNet", modality="L"
        )
        print(submission.wait().scores["miou"])

**Conventions.** Answers are the API's own JSON objects (`/api/v1/openapi.json`); what is refused is raised as a
`StoneError` with its `code`. A submission that was begun is gone on with, never sent twice.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from stone_client.api import Api
from stone_client.baseline import BaselinePlan, write_baseline
from stone_client.credentials import Server, choose_server, plain_url
from stone_client.files.datasets import dataset_name
from stone_client.progress import Report
from stone_client.server import benchmarks, boards, scores, teams
from stone_client.server import dataset_imports as imports
from stone_client.server import submission as submitting
from stone_client.server.job_following import follow
from stone_client.server.label_sets import delete_label_set, label_sets_of
from stone_client.server.places import place_named
from stone_client.server.sequences import Item, find_sequence
from stone_files.grid_file import chosen_grid

StrPath = str | Path


def ignore_progress(_stage: str, _done: int, _total: int) -> None:
    """Nobody asks how far it is."""


class Submission:
    """One submission: `state`, and once it is scored its `scores`, `results` and breakdowns."""

    def __init__(self, api: Api, item: Item, progress: Report = ignore_progress) -> None:
        self._api, self._item, self._progress = api, item, progress

    @property
    def id(self) -> str:
        return str(self._item["id"])

    @property
    def state(self) -> str:
        """draft, queued, scoring, then scored, valid, invalid, failed or cancelled; asked of the server."""
        self._item = self._api.read(f"/submissions/{self.id}")
        return str(self._item["state"])

    def wait(self) -> "Submission":
        """Itself, once it is scored or found valid. Raises `SubmissionInvalidError`, `SubmissionEndedError`."""
        self._item = submitting.settled(self._api, self._item, self._progress)
        return self

    @property
    def scores(self) -> Mapping[str, float | None]:
        """The ratios by name: miou, iou_occ, iou_t, iou_p, iou_n; None where undefined."""
        total: Mapping[str, float | None] = self.results["total"]
        return total

    @property
    def results(self) -> Mapping[str, Any]:
        """Totals, intervals, supports and extra figures, as far as they are shown to the caller."""
        return scores.read_results(self._api, self.id)

    def breakdown(self, by: str) -> Mapping[str, Any]:
        """The result by sequence, environment, illumination or distance."""
        return scores.read_breakdown(self._api, self.id, by)

    def withdraw(self, reason: str = "") -> None:
        """Take it off every board, for good."""
        self._item = submitting.withdraw(self._api, self.id, reason)

    def __repr__(self) -> str:
        return f"<Submission {self.id} {self._item['state']}>"


class Stone:
    """A server; without arguments the one that `stone auth login` or STONE_URL and STONE_TOKEN name.

    `progress(stage, done, total)` is called as things go on.
    """

    def __init__(self, url: str = "", token: str = "", progress: Report = ignore_progress) -> None:
        self.api = Api(Server(plain_url(url), token) if url and token else choose_server(url or None))
        self._progress = progress

    def __enter__(self) -> "Stone":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        self.api.__exit__(None, None, None)

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
        """Send a zip of predictions; `kind` is entry, validation (only checked) or baseline (organisers')."""
        at = (str(self.phase(benchmark, phase)["id"]), str(teams.find_team(self.api, team)["id"]))
        entry = submitting.SubmissionDescription(*at, method, modality, description, kind)
        return Submission(self.api, submitting.submit(self.api, Path(path), entry, self._progress), self._progress)

    def import_dataset(
        self,
        path: StrPath,
        *,
        in_place: bool = False,
        name: str = "",
        classes: StrPath | None = None,
        layout: str | None = None,
        grid: str | None = None,
        adds_to_existing: bool = False,
        sets_splits: bool = False,
        is_public: bool = False,
    ) -> Item:
        """Send a published dataset in a folder, tar or ZIP; its import, once a sequence stands for every scene.

        With `in_place` the server reads the archive at `path`, a ROOT:PATH, where it lies. `grid` is a name or a file.
        Raises a `DatasetFaultError` for what its layout tells, `JobFailedError` with the code of what the server found.
        """
        said = None if classes is None else Path(classes).read_text("utf-8")
        existing = "add" if adds_to_existing else "refuse"
        stated = chosen_grid(grid).as_record() if grid else None
        place = place_named(str(path), with_pictures=False) if in_place else None
        called = name or dataset_name(Path(place.path if place else path))
        wishes = imports.DatasetWishes(called, said, existing, sets_splits, is_public, layout, stated)
        if place is not None:
            begun = imports.import_in_place(self.api, place, wishes)
        else:
            begun = imports.send_dataset(self.api, Path(path), wishes, self._progress)
        follow(self.api, begun["job_id"], self._progress)
        return imports.read_import(self.api, begun["id"])

    def label_sets(self, sequence: str) -> list[Item]:
        """The label sets of a sequence (name or id), newest first; each says how well it holds: `held_out_recall` over
        `held_out_m` metres of way, and its `gravest` finding."""
        return label_sets_of(self.api, find_sequence(self.api, sequence)["id"])

    def delete_label_set(self, sequence: str, label_set: str) -> str:
        """Delete a label set (id, latest, latest~1, …) of a sequence, free its bytes and return its id.

        Raises `label_set_pinned` if an export, a version, a phase, the draft splits or a public sequence relies on it.
        """
        return delete_label_set(self.api, find_sequence(self.api, sequence), label_set)

    def submission(self, submission_id: str) -> Submission:
        """One of one's own."""
        return Submission(self.api, self.api.read(f"/submissions/{submission_id}"), self._progress)

    def phase(self, benchmark: str, phase: str) -> Item:
        """Rules, dates, by what it is scored."""
        return benchmarks.read_phase(self.api, benchmark, phase)

    def manifest(self, benchmark: str, phase: str, output: StrPath) -> Path:
        """Write the frames that are to be predicted."""
        return Path(benchmarks.fetch_manifest(self.api, (benchmark, phase), Path(output))["output"])

    def inputs(self, benchmark: str, phase: str, folder: StrPath) -> list[Path]:
        """Fetch what is to be predicted from, as far as it is not there: a tar for each sequence."""
        files = benchmarks.download_inputs(self.api, (benchmark, phase), Path(folder), self._progress)
        return [Path(file["output"]) for file in files]

    def baseline(self, sources: Iterable[StrPath], manifest: StrPath, output: StrPath) -> Path:
        """Write the geometric baseline's predictions for the frames of a manifest, as `stone baseline` does."""
        from stone_client.options import cores

        plan = BaselinePlan(Path(manifest), Path(output), cores())
        return Path(write_baseline([Path(source) for source in sources], plan, self._progress).output)

    def leaderboard(self, benchmark: str, phase: str, track: str = "all", as_of: str = "") -> Mapping[str, Any]:
        """The board, now or as it stood at a time such as 2026-06-01T00:00:00Z."""
        return boards.read_board(self.api, boards.BoardSelection(benchmark, phase, track, as_of))

    def compare(self, a: str, b: str) -> Mapping[str, Any]:
        """The differences of two submissions to one phase, and whether they are more than chance."""
        return scores.compare(self.api, a, b)
