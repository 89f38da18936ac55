"""A dataset's stages on a platform, over HTTP and with the commands of `stone`."""

import os
import sqlite3
import subprocess
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.release_import.run import ImportFailedError
from benchmarks.release_twin.stages import stage
from stone_client.api import Api
from stone_client.sdk import ignore_progress
from stone_client.server.benchmarks import download_inputs, fetch_manifest
from stone_client.server.dataset_imports import DatasetWishes, read_import, send_dataset
from stone_client.server.exports import download_archive, make_export
from stone_client.server.job_following import follow
from stone_client.server.scores import read_results
from stone_client.server.splits import proposal
from stone_client.server.submission import SubmissionDescription, settled, submit
from testing.stone_serve import STONE
from testing.worlds.released_datasets import ReleasedDataset

LOOK_S = 0.5
ENDED = ("succeeded", "failed", "cancelled")
REASON = "a benchmark of the release's twin"


@dataclass(frozen=True)
class TwinSplits:
    """The number of scenes per split: whole drives, with test in a place of its own."""

    train: int
    val: int
    test: int


@dataclass(frozen=True)
class Way:
    """A dataset in a ZIP, the folder for downloads, and the platform's folder `data` in it."""

    what: ReleasedDataset
    path: Path
    folder: Path
    has_playback: bool = True

    @property
    def data(self) -> Path:
        return self.folder / "data"

    def frames(self, scenes: int) -> int:
        return scenes * self.what.frames

    def check(self) -> None:
        """Run `stone check` on the whole ZIP."""
        with stage("stone check", self.frames(self.what.scenes), self.data):
            self._command("check", str(self.path))

    def go(self, api: Api) -> None:
        """Run all stages from the ZIP to a board and an export."""
        self._import(api)
        splits = splits_of(self.what)
        self._publish(api, splits)
        phase = self._open_phase(api, splits)
        self._compete(api, phase, splits)
        self._export(api)

    def _import(self, api: Api) -> None:
        everything = self.frames(self.what.scenes)
        with stage("upload", everything, self.data):
            accepted = send_dataset(api, self.path, DatasetWishes("twin"), ignore_progress)
        state = read_import(api, str(accepted["id"]))
        with stage("import: keep and index", everything, self.data):
            while state["scenes_total"] is None and state["state"] not in ENDED:
                time.sleep(LOOK_S)
                state = read_import(api, str(accepted["id"]))
        with stage("import: scenes and publication", everything, self.data):
            while state["state"] not in ENDED:
                time.sleep(LOOK_S)
                state = read_import(api, str(accepted["id"]))
        if state["state"] != "succeeded":
            raise ImportFailedError(str(state["failure"]))
        if self.has_playback:
            with stage("playback of every scene", everything, self.data):
                self._wait_until_idle()

    def _publish(self, api: Api, splits: TwinSplits) -> None:
        everything = self.frames(self.what.scenes)
        with stage("splits: proposed by drive, put", everything, self.data):
            made = proposal(api, (splits.train, splits.val, splits.test), ())
            body = {part: [item["sequence_id"] for item in made[part]] for part in ("train", "val", "test")}
            revision = api.read("/splits")["revision"]
            request = {"json": {**body, "reason": REASON}, "headers": {"If-Match": f'"{revision}"'}}
            api.send("PUT", "/splits", **request)
        in_version = self.frames(splits.train + splits.val + splits.test)
        with stage("version published", in_version, self.data):
            api.create("/datasets", {"name": "twin-1.0", "licence": "CC-BY-NC-ND-4.0", "reason": REASON})
        with stage("its inputs: train and val", self.frames(splits.train + splits.val), self.data):
            self._wait_until_idle()

    def _open_phase(self, api: Api, splits: TwinSplits) -> str:
        hidden = self.frames(splits.test)
        phase = {"name": "test", "part": "test", "mask": "lidar", "is_hidden": True, "scorings_per_window": 5}
        body = {"name": "twin", "dataset": "twin-1.0", "phases": [phase], "reason": REASON}
        with stage("hidden phase, its ground truth", hidden, self.data):
            phase_id = str(api.create("/admin/benchmarks", body)["phases"][0]["id"])
            api.create(f"/admin/phases/{phase_id}/ground-truths", {"reason": REASON})
            while api.read("/benchmarks/twin/phases/test")["active"] is None:
                time.sleep(LOOK_S)
        with stage("its inputs", hidden, self.data):
            follow(api, api.create(f"/admin/phases/{phase_id}/inputs", {"reason": REASON})["id"], ignore_progress)
        return phase_id

    def _compete(self, api: Api, phase_id: str, splits: TwinSplits) -> None:
        hidden, of = self.frames(splits.test), ("twin", "test")
        inputs, manifest, sent = (self.folder / name for name in ("inputs", "manifest.json", "sub.zip"))
        with stage("inputs downloaded", hidden, self.data):
            download_inputs(api, of, inputs, ignore_progress)
            fetch_manifest(api, of, manifest)
        with stage("stone baseline", hidden, self.data):
            self._command("baseline", str(inputs), "--manifest", str(manifest), "-o", str(sent))
        team = api.create("/teams", {"name": "Geometry"})
        entry = SubmissionDescription(phase_id, team["id"], "geometry", "L")
        with stage("submission sent and scored", hidden, self.data):
            made = settled(api, submit(api, sent, entry, ignore_progress), ignore_progress)
        with stage("board", 0, self.data):
            board = api.read("/benchmarks/twin/phases/test/leaderboard")
        scores = read_results(api, made["id"])["total"]
        print(f"  {board['ranked_total']} ranked; mIoU of the baseline {scores['miou']:.4f}", flush=True)

    def _export(self, api: Api) -> None:
        sequence: dict[str, Any] = next(api.pages("/sequences"))
        with stage("export: one scene, nuscenes, tar", self.what.frames, self.data):
            export = make_export(api, sequence, "nuscenes", ignore_progress)
            download_archive(api, export, self.folder / "export.tar", ignore_progress)

    def _wait_until_idle(self) -> None:
        """Wait until no job is left, by the platform's own rows."""
        left = "SELECT count(*) FROM jobs WHERE queue != '' AND state IN ('queued', 'running')"
        with closing(sqlite3.connect(f"file:{self.data / 'stone.sqlite3'}?mode=ro", uri=True)) as database:
            while database.execute(left).fetchone()[0]:
                time.sleep(LOOK_S)

    def _command(self, *words: str) -> None:
        subprocess.run([*STONE, *words], check=True, stdout=subprocess.DEVNULL, env={**os.environ, "NO_COLOR": "1"})


def splits_of(what: ReleasedDataset) -> TwinSplits:
    """Return the last drive for test, alone in its place; one drive of another place for val; the others for train."""
    drives = [
        range(first, min(first + what.drive_scenes, what.scenes)) for first in range(0, what.scenes, what.drive_scenes)
    ]
    elsewhere = [drive for drive in drives if what.tables.location(drive[0]) != what.tables.location(drives[-1][0])]
    return TwinSplits(sum(map(len, elsewhere[1:])), len(elsewhere[0]), len(drives[-1]))


def cpu_by_kind(data: Path) -> Sequence[str]:
    """Return the processor seconds of the jobs of each kind, as counted by the platform."""
    query = (
        "SELECT kind, count(DISTINCT jobs.id), sum(cpu_s) FROM jobs JOIN job_attempts ON job_id = id "
        "GROUP BY kind ORDER BY 3 DESC"
    )
    with closing(sqlite3.connect(f"file:{data / 'stone.sqlite3'}?mode=ro", uri=True)) as database:
        return [f"  {kind}: {count} jobs, {cpu_s or 0:.1f} CPU s" for kind, count, cpu_s in database.execute(query)]
