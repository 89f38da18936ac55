"""Training: a run that goes on is one that never stopped; what cannot be trained is refused and says why."""

import math
from dataclasses import replace
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from baselines import train as training
from baselines import training_state
from baselines.batch import Batch
from baselines.cache import cached_frames
from baselines.checkpoint import CHECKPOINT, provenance_of
from baselines.metrics import RateSchedule, take_step
from baselines.models.occupancy_model import OccupancyModel
from baselines.predict import PredictionPlan, predict
from baselines.row_config import RowConfig, TrainingConfig, row_of
from baselines.run_folder import LOG, TENSORBOARD
from baselines.sources import labelled_frames
from baselines.train import TrainingPlan
from stone_base.label_grid import RELEASE
from stone_exports.files import ExportFileSpan
from stone_exports.labels import observed_classes
from stone_files.npz import npz_bytes
from stone_submissions.archive import open_submission
from stone_submissions.manifest import Manifest, write_manifest
from stone_submissions.validation import frame_grid, validate
from testing.refusals import refused_as
from testing.worlds.small_export import SmallExport, write_small_export
from tests.baselines.small_training import (
    is_same_run,
    logged,
    logged_steps,
    row_record,
    small_row,
    stopped_after,
    tensors_of,
    trained,
)

STEPS = 8  # two epochs of nine frames in batches of two


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def whole(meadow: Path, cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that never stopped."""
    run = tmp_path_factory.mktemp("whole") / "run"
    ended = trained(TrainingPlan(small_row(), (meadow,), run, watch=(meadow,), cache=cache))
    assert (ended.steps, ended.frames) == (STEPS, 9)
    return run


@pytest.fixture
def plan(meadow: Path, cache: Path, tmp_path: Path) -> TrainingPlan:
    return TrainingPlan(small_row(), (meadow,), tmp_path / "run", watch=(meadow,), cache=cache)


@pytest.mark.parametrize("step", [1, 3])
def test_a_run_that_goes_on_is_one_that_never_stopped(plan: TrainingPlan, whole: Path, step: int) -> None:
    """Bit for bit, wherever it stopped: before the first checkpoint, within an epoch.

    Catches alone a part of the state that checkpoints lack: order, augmentation, optimiser, statistics of norms.
    """
    stopped_after(plan, step)
    trained(replace(plan, resume=True))
    assert is_same_run(plan.run, whole)
    assert logged_steps(plan.run) == list(range(1, STEPS + 1))
    told = [{key: line[key] for key in ("step", "epoch", "losses", "scores", "watched")} for line in logged(plan.run)]
    assert told == [
        {key: line[key] for key in ("step", "epoch", "losses", "scores", "watched")} for line in logged(whole)
    ]


def test_a_run_that_has_ended_stays_as_it_is(plan: TrainingPlan, whole: Path) -> None:
    trained(plan)
    trained(replace(plan, resume=True))
    assert is_same_run(plan.run, whole)
    assert logged_steps(plan.run) == list(range(1, STEPS + 1))


def test_loader_processes_change_nothing(plan: TrainingPlan, whole: Path) -> None:
    """Catches alone augmentation or order that depends on which process reads a frame."""
    trained(replace(plan, loaders=1))
    assert is_same_run(plan.run, whole)


def test_another_seed_is_another_run(plan: TrainingPlan, whole: Path) -> None:
    trained(replace(plan, row=small_row(seed=1)))
    assert not is_same_run(plan.run, whole)


def test_training_learns(whole: Path) -> None:
    losses = [sum(line["losses"].values()) for line in logged(whole) if line["losses"]]
    assert sum(losses[-2:]) < 0.95 * sum(losses[:2])


def test_what_is_watched_is_scored_after_each_epoch_and_the_best_is_kept(whole: Path) -> None:
    watched = [line for line in logged(whole) if line["watched"]]
    assert [(line["epoch"], line["step"]) for line in watched] == [(0, 4), (1, 8)]
    best = max(line["scores"]["miou"] or 0.0 for line in watched)
    assert provenance_of(whole / CHECKPOINT).best_miou == pytest.approx(best)
    assert any((whole / TENSORBOARD).iterdir())


def test_a_log_that_a_kill_cut_is_read_to_its_last_whole_line(plan: TrainingPlan, whole: Path) -> None:
    stopped_after(plan, 5)
    log = plan.run / LOG
    log.write_text(log.read_text() + '{"epoch": 1, "losses": {"a": 1.0}')
    trained(replace(plan, resume=True))
    assert logged_steps(plan.run) == logged_steps(whole)


def test_a_folder_that_holds_a_run_is_not_written_over(plan: TrainingPlan) -> None:
    stopped_after(plan, 2)
    with refused_as("run_exists"):
        trained(plan)


def test_nothing_is_resumed_where_nothing_began(plan: TrainingPlan) -> None:
    with refused_as("bad_run"):
        trained(replace(plan, resume=True))
    assert not plan.run.exists()


def test_a_run_goes_on_with_its_own_row_only(plan: TrainingPlan) -> None:
    stopped_after(plan, 2)
    with refused_as("bad_run", match="learning_rate"):
        trained(replace(plan, resume=True, row=small_row(learning_rate=0.1)))


def test_a_run_goes_on_with_its_own_data_only(plan: TrainingPlan, tmp_path: Path) -> None:
    stopped_after(plan, 3)
    other = write_small_export(tmp_path / "other", SmallExport("other", 9))
    with refused_as("bad_run", match="data"):
        trained(replace(plan, resume=True, exports=(other,)))


@pytest.mark.parametrize("content", [b"", b"\x02\0\0\0\0\0\0\0{}", b"x" * 100])
def test_a_checkpoint_that_is_none_is_refused(plan: TrainingPlan, content: bytes) -> None:
    stopped_after(plan, 2)
    (plan.run / CHECKPOINT).write_bytes(content)
    with refused_as("bad_run"):
        trained(replace(plan, resume=True))


def test_exports_without_labels_are_refused(plan: TrainingPlan, tmp_path: Path) -> None:
    bare = write_small_export(tmp_path / "bare", SmallExport(is_labelled=False))
    with refused_as("nothing_to_train_on"):
        trained(replace(plan, exports=(bare,)))


def test_a_least_confidence_is_required_of_what_is_trained_on_and_not_of_what_is_watched(
    plan: TrainingPlan, meadow: Path, tmp_path: Path
) -> None:
    limited = replace(plan, row=small_row(epochs=1, least_confidence=0.9))
    with refused_as("no_confidence", match="stone label --confidence"):
        trained(limited)
    sure = copytree(meadow, tmp_path / "sure")
    for path in sure.glob("gts/*/*/labels.npz"):
        arrays = dict(np.load(path))
        path.write_bytes(
            npz_bytes(arrays | {"confidence": np.where(arrays["semantics"] == 3, 255, 1).astype(np.uint8)})
        )
    trained(replace(limited, exports=(sure,), run=tmp_path / "limited"))
    (watched,) = (line for line in logged(tmp_path / "limited") if line["watched"])
    assert watched["scores"]["iou_t"] is not None


def test_fewer_frames_than_a_step_takes_are_refused(plan: TrainingPlan) -> None:
    with refused_as("too_few_frames", match=r"\b9 .* 12\b"):
        trained(replace(plan, row=small_row(batch=4, accumulate=3)))


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU here")
def test_a_gpu_that_is_not_there_is_refused(plan: TrainingPlan) -> None:
    with refused_as("no_accelerator"):
        trained(replace(plan, device="cuda"))
    assert not plan.run.exists()


class SmallNet(OccupancyModel[Tensor]):
    """Two weights a class, without normalisation: logits of a voxel are of how many points it has.

    `falls_ill_at` the step of this number: then its loss, or only its gradient, is no number.
    """

    def __init__(self, config: Any, falls_ill_at: int = -1, illness: str = "loss") -> None:
        super().__init__()
        self.lattice, self.modality = config.lattice, "L"
        self.weight = nn.Parameter(torch.linspace(-1, 1, 8).reshape(4, 2))
        self.steps, self.falls_ill_at, self.illness = 0, falls_ill_at, illness

    def forward(self, batch: Batch) -> Tensor:
        places, is_in = self.lattice.indices_of(batch.lidar.features[:, :3])
        counts = torch.zeros(len(batch), *self.lattice.shape)
        x, y, z = places[is_in].T
        counts.index_put_((batch.lidar.frame[is_in], x, y, z), torch.ones(len(x)), accumulate=True)
        features = torch.stack([torch.ones_like(counts), counts.clamp(max=4)], dim=-1)
        return (features @ self.weight.T).movedim(-1, 1)

    def losses(self, outputs: Tensor, batch: Batch) -> dict[str, Tensor]:
        loss = nn.functional.cross_entropy(outputs, batch.labels.long(), ignore_index=255)
        self.steps += 1
        if self.steps > self.falls_ill_at >= 0:
            zero = (self.weight * 0).sum()
            loss = loss + (math.nan if self.illness == "loss" else torch.sqrt(zero))
        return {"cross_entropy": loss}

    def logits(self, outputs: Tensor, batch: Batch) -> Tensor:
        return outputs.float()


@pytest.fixture
def small_net(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Rows are this network, whatever they say."""
    monkeypatch.setattr(training_state, "build_model", SmallNet)
    return monkeypatch


def test_accumulated_batches_are_one_larger_batch(plan: TrainingPlan, tmp_path: Path, small_net: object) -> None:
    four = small_row(batch=4, epochs=3)
    trained(replace(plan, row=four))
    for batch, accumulate in ((2, 2), (1, 4)):
        run = tmp_path / f"of-{batch}"
        trained(replace(plan, run=run, row=small_row(batch=batch, accumulate=accumulate, epochs=3)))
        assert provenance_of(run / CHECKPOINT).position.step == 6
        torch.testing.assert_close(tensors_of(run), tensors_of(plan.run), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("illness", ["loss", "gradient"])
def test_a_run_that_diverges_ends_with_the_step_and_a_sound_checkpoint(
    plan: TrainingPlan, small_net: pytest.MonkeyPatch, illness: str
) -> None:
    small_net.setattr(training_state, "build_model", lambda config: SmallNet(config, 3, illness))
    with refused_as("training_diverged", match="step 3"):
        trained(plan)
    assert provenance_of(plan.run / CHECKPOINT).position.step == 2
    assert all(
        value.isfinite().all() for value in tensors_of(plan.run, CHECKPOINT).values() if value.is_floating_point()
    )
    assert logged_steps(plan.run) == [1, 2, 3]


@pytest.mark.parametrize(
    "error",
    [
        torch.OutOfMemoryError("CUDA out of memory."),
        RuntimeError("[enforce fail at alloc_cpu.cpp:124] . DefaultCPUAllocator: can't allocate memory: you tried"),
    ],
)
def test_too_little_memory_is_said_with_what_to_do(
    plan: TrainingPlan, small_net: pytest.MonkeyPatch, error: Exception
) -> None:
    def full(*_: object) -> float:
        raise error

    small_net.setattr(training, "take_step", full)
    with refused_as("too_little_memory"):
        trained(plan)


def test_every_nth_frame_of_each_sequence_is_trained_on(meadow: Path, tmp_path: Path, cache: Path) -> None:
    other = write_small_export(tmp_path / "other", SmallExport("quarry", 4))
    row: RowConfig = small_row()
    frames = cached_frames(labelled_frames((other, meadow)), row.inputs, cache, lambda *_: None)
    targets = training.targets_of(frames, 3)
    assert [(frames[index].sequence, index) for index in targets] == [
        ("meadow", 0), ("meadow", 3), ("meadow", 6), ("quarry", 9), ("quarry", 12),
    ]  # fmt: skip


def test_the_rate_rises_and_falls() -> None:
    schedule = RateSchedule(TrainingConfig(warmup_steps=10), 100)
    ratios = [schedule.ratio(step) for step in range(101)]
    assert ratios[0] == pytest.approx(1 / 3)
    assert ratios[10] == 1
    assert ratios[:11] == sorted(ratios[:11])
    assert ratios[10:] == sorted(ratios[10:], reverse=True)
    assert ratios[100] == pytest.approx(1e-3)
    assert RateSchedule(TrainingConfig(warmup_steps=0), 3).ratio(0) == 1


def test_a_step_clips_and_clears() -> None:
    weight = nn.Parameter(torch.zeros(2))
    optimizer = torch.optim.SGD([{"params": [weight], "scale": 0.5}], lr=1.0)
    weight.grad = torch.tensor([30.0, 40.0])
    assert take_step([weight], optimizer, 1.0, 1.0) == pytest.approx(50)
    assert weight.grad is None
    torch.testing.assert_close(weight.detach(), torch.tensor([-0.3, -0.4]))


def test_a_row_of_the_releases_grid_is_trained_on_its_labels_and_predicts_them(tmp_path: Path) -> None:
    """From an export as the released dataset lays labels out; what is predicted has its shape, and no other is
    asked."""
    export = write_small_export(tmp_path / "rig", SmallExport("meadow", 6, grid=RELEASE))
    lattice = {"min_m": [-6.4, -6.4, -1.0], "voxel_m": [0.4, 0.4, 0.4], "shape": [32, 32, 16]}
    record = row_record(epochs=4) | {"grid": "release"}
    row = row_of("small", record | {"model": record["model"] | {"lattice": lattice}})
    run = tmp_path / "run"
    told = trained(TrainingPlan(row, (export,), run))
    assert told.frames == 6
    tokens = SmallExport("meadow", 6).tokens
    write_manifest(tmp_path / "m.json", Manifest({"meadow": tokens}, RELEASE))
    predict(PredictionPlan(run, (export,), tmp_path / "m.json", tmp_path / "sub.zip"), lambda *_: None)
    assert validate(tmp_path / "sub.zip", tmp_path / "m.json").ok
    with open_submission(tmp_path / "sub.zip", tokens, RELEASE) as submission:
        predicted = frame_grid(submission, tokens[3])
    path = export / "gts" / "meadow" / tokens[3] / "labels.npz"
    truth = observed_classes(ExportFileSpan(path, "labels.npz", 0, path.stat().st_size), grid=RELEASE)
    both = ((predicted > 0) & (truth > 0) & (truth < 4)).sum()
    assert both > 0.5 * ((truth > 0) & (truth < 4)).sum() > 50
    write_manifest(tmp_path / "paper.json", Manifest({"meadow": tokens}))
    with refused_as("grids_differ"):
        predict(PredictionPlan(run, (export,), tmp_path / "paper.json", tmp_path / "no.zip"), lambda *_: None)


def test_a_row_whose_lattice_is_no_part_of_its_grid_is_refused() -> None:
    for wrong in ({"grid": "release"}, {"grid": "mars"}, {"grid": {"name": "own"}}):
        with refused_as("bad_row"):
            row_of("small", row_record() | wrong)
    own = {"name": "ahead", "min_m": [0.0, -12.8, -2.0], "voxel_m": 0.2, "shape": [128, 128, 32]}
    record = row_record() | {"grid": own}
    model = {key: value for key, value in record["model"].items() if key != "lattice"}
    with refused_as("bad_row") as refusal:
        row_of("small", record | {"model": model})
    assert "mirror_x_ratio" in str(refusal.value)
    row = row_of("small", record | {"model": model, "augment": {"mirror_x_ratio": 0.0}})
    assert row.model.lattice.is_whole(row.label_grid)
