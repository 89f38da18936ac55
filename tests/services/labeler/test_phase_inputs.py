"""Inputs of a phase or a version made by the queue from a labelled sequence: once, without a byte of a label, for good.

Catches alone inputs of a phase that hold labels, or go with their sequence.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sqlalchemy import select

from services.domain.benchmarks.phases.inputs import RUN, inputs_of, locate_input, start_inputs
from services.domain.benchmarks.phases.phases import NewBenchmark, NewPhase, create_benchmark, create_phase
from services.domain.benchmarks.phases.unordered_frames import unordered_frames
from services.domain.datasets.input_jobs import start_version_inputs
from services.domain.datasets.queries import dataset_named
from services.domain.sequences.processing import delete_sequence
from services.domain.sequences.recordings import remove_recording
from services.runtime.orm import Benchmark, Dataset, DatasetInput, Job, LabelledFrameRow, Phase, PhaseInput
from services.runtime.platform import Platform
from services.runtime.settings import StoreSettings
from services.runtime.store.garbage_collection import collect_garbage
from testing.refusals import refused_as
from testing.worlds.drives import files_at, labelled_platform
from testing.worlds.published import dataset
from testing.worlds.runs import Brought, run_all

pytestmark = pytest.mark.whole


@dataclass(frozen=True)
class Asked:
    """A platform with a labelled sequence in the hidden part of a version, and a phase over it."""

    brought: Brought
    phase_id: str

    @property
    def platform(self) -> Platform:
        return self.brought.platform

    def start(self) -> str:
        with self.platform.database.transaction() as session:
            return start_inputs(session, session.get_one(Phase, self.phase_id), self.brought.owner_id).id

    def job(self, job_id: str) -> Job:
        return self.brought.job(job_id)

    def rows(self) -> list[PhaseInput]:
        with self.platform.database.reading() as session:
            return list(session.scalars(inputs_of(self.phase_id)))

    def files(self) -> dict[str, bytes]:
        (row,) = self.rows()
        with self.platform.database.reading() as session:
            return files_at(self.platform, locate_input(session, row))


@pytest.fixture
def asked(tmp_path_factory: pytest.TempPathFactory, tmp_path: Path) -> Iterator[Asked]:
    """On a platform of the test's own; what nobody needs may be collected at once."""
    store = StoreSettings(grace_s=0.0)
    with labelled_platform(tmp_path_factory, tmp_path / "platform", store=store) as brought:
        name = dataset(brought.platform, brought.owner_id, {"test": [brought.sequence_id]})
        with brought.platform.database.transaction() as session:
            version = dataset_named(session, name)
            assert version is not None
            benchmark = create_benchmark(session, NewBenchmark("stone", "STONE", "", brought.owner_id))
            phase = create_phase(session, benchmark, version, NewPhase("test", "test", is_hidden=True))
            phase_id = phase.id
        yield Asked(brought, phase_id)


def tokens(platform: Platform) -> tuple[str, ...]:
    with platform.database.reading() as session:
        return tuple(session.scalars(select(LabelledFrameRow.token).order_by(LabelledFrameRow.ordinal)))


def label_bytes(asked: Asked) -> dict[str, bytes]:
    """Everything that labelling made: label files, mesh, pictures, report, frame table."""
    return {name: content for name, content in asked.brought.files().items() if name != "sequence.npz"}


def table(files: Mapping[str, bytes], name: str) -> Any:
    return json.loads(files[f"v1.0-trainval/{name}.json"])


def test_inputs_of_a_version_are_byte_for_byte_those_of_a_phase(asked: Asked) -> None:
    """The same stage makes both, so whatever is said of a phase's below is so of a version's."""
    name = dataset(asked.platform, asked.brought.owner_id, {"train": [asked.brought.sequence_id]})
    asked.start()
    with asked.platform.database.transaction() as session:
        version = dataset_named(session, name)
        assert version is not None
        run_id = start_version_inputs(session, version, asked.brought.owner_id).id
    assert run_all(asked.platform) == 2
    assert asked.job(run_id).state == "succeeded"
    with asked.platform.database.reading() as session:
        (of_version,) = session.scalars(select(DatasetInput))
    (of_phase,) = asked.rows()
    assert (of_version.name, of_version.tar_sha256) == (of_phase.name, of_phase.tar_sha256)


def test_inputs_without_order_hold_every_second_frame_under_the_tokens_of_the_phase(asked: Asked) -> None:
    with asked.platform.database.transaction() as session:
        first = session.get_one(Phase, asked.phase_id)
        benchmark = session.get_one(Benchmark, first.benchmark_id)
        version = session.get_one(Dataset, first.dataset_id)
        phase = create_phase(session, benchmark, version, NewPhase("unordered", "test", True, every_nth=2))
        chosen = unordered_frames(phase.every_nth, phase.token_key)
    unordered = replace(asked, phase_id=phase.id)
    unordered.start()
    assert run_all(asked.platform) == 1
    files = unordered.files()
    assert chosen is not None
    own = tokens(asked.platform)
    assert [row["token"] for row in table(files, "sample")] == [token for token, _ in chosen.of(own)]
    everything = b"".join(files.values()) + "".join(files).encode()
    assert not [token for token in own if token.encode() in everything]


def test_inputs_hold_the_frames_of_the_labels_and_no_label(asked: Asked) -> None:
    run_id = asked.start()
    assert run_all(asked.platform) == 1
    assert (asked.job(run_id).state, asked.job(run_id).kind) == ("succeeded", RUN)
    files = asked.files()
    assert tuple(row["token"] for row in table(files, "sample")) == tokens(asked.platform)
    assert {name.split("/")[0] for name in files} == {"samples", "v1.0-trainval", "maps", "sha256sum.txt"}
    made = label_bytes(asked)
    assert len(made) > len(tokens(asked.platform))
    contents = set(files.values())
    for name, content in made.items():
        assert content not in contents, name
        assert not any(content in other for other in contents), name
    sweep = next(content for name, content in files.items() if "LIDAR_TOP" in name)
    assert len(np.frombuffer(sweep, "<f4").reshape(-1, 5)) > 500


def test_inputs_are_made_once(asked: Asked) -> None:
    assert asked.start() == asked.start(), "the run that is at it answers"
    run_all(asked.platform)
    with refused_as("inputs_complete"):
        asked.start()


def test_inputs_outlive_the_sequence(asked: Asked) -> None:
    asked.start()
    run_all(asked.platform)
    before = asked.files()
    with asked.platform.database.transaction() as session:
        delete_sequence(session, asked.brought.sequence())
    assert collect_garbage(asked.platform).objects > 0
    assert asked.files() == before


def test_without_a_recording_there_are_no_inputs(asked: Asked) -> None:
    with asked.platform.database.transaction() as session:
        remove_recording(session, asked.brought.recording())
    with refused_as("inputs_impossible", match="field"):
        asked.start()


def test_a_recording_that_goes_meanwhile_fails_the_job_and_leaves_no_row(asked: Asked) -> None:
    run_id = asked.start()
    with asked.platform.database.transaction() as session:
        remove_recording(session, asked.brought.recording())
    run_all(asked.platform)
    (job,) = (job for job in asked.brought.jobs(run_id) if job.queue)
    assert (asked.job(run_id).state, job.failure_code) == ("failed", "recording_deleted")
    assert asked.rows() == []
