"""The demo: simulate, upload, process, download, export, predict, submit, and show the leaderboard.

**Conventions.** The way to the labels is through a server's API, as in the field. Everything lands in one folder, which
appears whole or not at all; `demo.json` marks it as ours, so that the next demo may replace it.
"""

import json
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from services.eval.ground_truth import find_ground_truth
from services.eval.pipeline import score
from services.runtime.embedded.supervisor import RunningPlatform
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from stone_client.api import Api
from stone_client.credentials import Server
from stone_client.files.bags import LocalBag, hashed_bag
from stone_client.files.label_download import download_labels
from stone_client.progress import Report
from stone_client.server.exports import download_archive, make_export
from stone_client.server.job_following import follow
from stone_client.server.sequences import (
    Item,
    add_recording,
    ensure_sequence,
    find_sequence,
    has_other_recording,
    pin_calibration,
    start_run,
)
from stone_local.baseline import BaselinePlan, write_baseline
from stone_local.demo.benchmark import enter_benchmark
from stone_local.demo.server import demo_server_of
from stone_submissions.manifest import write_manifest
from stone_submissions.validation import validate
from stone_submissions.verdict import SubmissionRefusedError

MARK = "demo.json"
EXPORTED = "nuscenes"
SEQUENCE = "demo"
SUBMISSION = "baseline.zip"
THREADS = 2


@dataclass(frozen=True)
class DemoPlan:
    """What to simulate, and the platform to label it: one of our own, which may still be starting, or a server."""

    simulation: SimulateOptions
    platform: RunningPlatform | Server


@dataclass(frozen=True)
class DemoRecording:
    """A run and the folder that everything about it goes to."""

    folder: Path

    @property
    def bag(self) -> Path:
        return self.folder / "run.mcap"

    @property
    def calibration(self) -> Path:
        return calibration_path(self.bag)


def run_demo(folder: Path, plan: DemoPlan, progress: Report) -> dict[str, Any]:
    """Fill `folder` and return the record that `demo.json` keeps."""
    recorded = DemoRecording(folder)
    simulate(recorded.bag, plan.simulation, folder / "truth", progress)
    demo_server = demo_server_of(plan.platform)
    with Api(demo_server.server) as api:
        sequence = label_on_server(api, recorded, progress)
        exported = export_on_server(api, sequence, folder, progress)
    scores = score_baseline(folder, progress)
    benchmark = enter_benchmark(demo_server, sequence, folder / SUBMISSION, progress)
    labels = json.loads((folder / "labels" / "report.json").read_text("utf-8"))
    record = {
        "url": demo_server.server.url,
        "sequence": sequence["name"],
        "labels": labels,
        "export": exported,
        "baseline": scores,
        "benchmark": benchmark,
    }
    (folder / MARK).write_text(json.dumps(record, indent=1, allow_nan=False) + "\n")
    return record


def label_on_server(api: Api, recorded: DemoRecording, progress: Report) -> Item:
    """The sequence, once its labels are in `labels/`: uploaded, processed, downloaded."""
    local = hashed_bag(recorded.bag, progress)
    sequence = _free_sequence(api, local)
    show_to_anybody(api, sequence)
    pin_calibration(api, sequence, recorded.calibration)
    add_recording(api, sequence, local, progress)
    follow(api, start_run(api, sequence, {})["id"], progress)
    labelled = find_sequence(api, sequence["id"])
    download_labels(api, labelled, recorded.folder / "labels", progress)
    return labelled


def show_to_anybody(api: Api, sequence: Item) -> None:
    """Make the sequence public: the first page shows it without an account."""
    sequence_now = find_sequence(api, sequence["id"])
    match = {"If-Match": f'"{sequence_now["revision"]}"'}
    api.send("PATCH", f"/sequences/{sequence['id']}", json={"is_public": True}, headers=match)


def export_on_server(api: Api, sequence: Item, folder: Path, progress: Report) -> dict[str, Any]:
    """The release layout of the sequence as `nuscenes.tar`; what came."""
    export = make_export(api, sequence, EXPORTED, progress)
    arrived = download_archive(api, export, folder / f"{EXPORTED}.tar", progress)
    return {"format": EXPORTED, "files": export["files"], **{key: arrived[key] for key in ("size_bytes", "sha256")}}


def score_baseline(folder: Path, progress: Report) -> dict[str, Any]:
    """Predict every frame from its own sweep in the export, validate and score that against the labels here.

    Raises `SubmissionRefusedError`.
    """
    manifest, output = folder / "manifest.json", folder / SUBMISSION
    write_manifest(manifest, find_ground_truth(folder / "labels").manifest)
    write_baseline([folder / f"{EXPORTED}.tar"], BaselinePlan(manifest, output, THREADS), progress)
    validation = validate(output, manifest, progress=progress)
    if not validation.ok:
        raise SubmissionRefusedError(validation)
    return score(output, folder / "labels", progress=progress).as_record()


def _free_sequence(api: Api, local: LocalBag) -> Item:
    """`demo`, or `demo-2`, … where that name is taken by another recording: nothing of the user's is replaced."""
    for number in count(1):
        sequence = ensure_sequence(api, SEQUENCE if number == 1 else f"{SEQUENCE}-{number}")
        if not has_other_recording(api, sequence, local):
            return sequence
    raise AssertionError
