"""Training of a row, from exports to weights. The page to read first.

    sources → cache → dataset → batches → losses → steps → checkpoint; validation → the best weights

**Conventions.** A run is a folder: `row.json`, `checkpoint.safetensors`, `weights.safetensors`, `log.jsonl`,
`tensorboard/`, and `frames/`, the cache, unless another is named. A killed run continues from its checkpoint; on a CPU
the result equals an uninterrupted run's, bit for bit.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader

from baselines.batch import Batch, CameraViews, Points, moved
from baselines.cache import CachedFrame, CachedStore, cached_frames
from baselines.checkpoint import load_backbone, write_weights
from baselines.data import EpochSampler, FrameDataset, FrameRequest
from baselines.frame_record import WantedLabels
from baselines.metrics import RateSchedule, confusion_of, scores_of, take_step
from baselines.models.occupancy_model import OccupancyModel
from baselines.processes import ProcessShare, joined_processes
from baselines.row_config import RowConfig
from baselines.run_folder import RunLog, TrainingReport, opened_run, write_run_row
from baselines.sources import labelled_frames
from baselines.training_state import TrainingState, initial_state, resumed_state
from stone.errors import Refused

# The collate function of loaders: one batch of several frames.


def joined(batches: Sequence[Batch]) -> Batch:
    """Return one batch of several, in their order."""
    cameras = [batch.cameras for batch in batches if batch.cameras is not None]
    labels = [batch.labels for batch in batches if batch.labels is not None]
    return Batch(
        tokens=tuple(token for batch in batches for token in batch.tokens),
        grid_from_ego=torch.cat([batch.grid_from_ego for batch in batches]),
        cameras=_joined_views(cameras) if cameras else None,
        lidar=_joined_points([batch.lidar for batch in batches if batch.lidar is not None]),
        radar=_joined_points([batch.radar for batch in batches if batch.radar is not None]),
        labels=torch.cat(labels) if labels else None,
    )


def _joined_views(views: Sequence[CameraViews]) -> CameraViews:
    depths = [view.depth_m for view in views if view.depth_m is not None]
    return CameraViews(
        torch.cat([view.images for view in views]),
        torch.cat([view.intrinsics for view in views]),
        torch.cat([view.augmented_from_image for view in views]),
        torch.cat([view.ego_from_camera for view in views]),
        torch.cat(depths) if depths else None,
    )


def _joined_points(points: Sequence[Points]) -> Points | None:
    if not points:
        return None
    frames = [torch.full_like(item.frame, index) for index, item in enumerate(points)]
    return Points(torch.cat([item.features for item in points]), torch.cat(frames))


# The rate of a run and its remaining time, from the steps of the last minutes.


STEPS_REMEMBERED = 200


class RunClock:
    """A clock that stamps reports; a process's first step, which is slower, is not counted."""

    def __init__(self, steps: int, begin: int) -> None:
        self._steps, self._begin = steps, begin
        self._times = deque[tuple[int, float]](maxlen=STEPS_REMEMBERED)

    def stamped(self, report: TrainingReport, frames_a_step: int) -> TrainingReport:
        """Return the report with rate and time left; both 0 until they are known."""
        self._times.append((report.step, monotonic()))
        (first, begun), (last, now) = self._times[0], self._times[-1]
        if last == first or now <= begun:
            return report
        seconds_a_step = (now - begun) / (last - first)
        left_s = (self._steps - report.step) * seconds_a_step
        return replace(report, frames_per_s=frames_a_step / seconds_a_step, left_s=left_s)


METRIC_EVERY = 10  # steps
CPU_IS_FULL = "DefaultCPUAllocator: can't allocate memory"  # torch has its own error only for a GPU
Reports = Callable[[TrainingReport], None]
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class TrainingPlan:
    """The row, the exports and the folder of the run.

    `watch`: validation exports, scored after each epoch and never trained on; the weights are then those of the best
    epoch, otherwise of the last. `loaders`: processes that read frames; 0 reads them in the training process.
    """

    row: RowConfig
    exports: tuple[Path, ...]
    run: Path
    watch: tuple[Path, ...] = ()
    resume: bool = False
    device: str = "cpu"
    cache: Path | None = None
    backbone: Path | None = None
    loaders: int = 0


@dataclass(frozen=True)
class TrainedRun:
    """The weights, their training data, and the best validation score."""

    run: str
    steps: int
    frames: int
    data_sha256: str
    best_miou: float | None


def train(plan: TrainingPlan, progress: Progress, reports: Reports) -> TrainedRun:
    """Train to the end of the plan, from the start or from the run's checkpoint.

    Raises what reading exports raises, `nothing_to_train_on`, `run_exists`, `bad_run`, `no_confidence`,
    `too_few_frames`, `training_diverged`, `too_little_memory`, `no_accelerator`.
    """
    with joined_processes(plan.device) as share:
        row, goes_on = opened_run(plan.run, plan.row, plan.resume)
        share.wait()  # all processes must check before one writes, or others would find an existing run
        if share.is_first:
            write_run_row(plan.run, row)
        frames = _frames(plan, plan.exports, progress, WantedLabels(row.training.least_confidence, row.label_grid))
        watched = _frames(plan, plan.watch, progress, WantedLabels(grid=row.label_grid)) if plan.watch else ()
        state = initial_state(row, frames, share)
        if goes_on:
            state = resumed_state(plan.run, state)
        elif plan.backbone is not None:
            load_backbone(state.model, plan.backbone)
        try:
            _Run(plan, share, state, (frames, watched)).train(reports)
        except RuntimeError as error:
            if not isinstance(error, torch.OutOfMemoryError) and CPU_IS_FULL not in str(error):
                raise
            raise Refused(
                "too_little_memory",
                f"{share.device!s} has too little memory for a step of {row.training.batch} frames: lower "
                "--batch, use --checkpoint-gradients, or train a smaller row",
            ) from error
    provenance = state.provenance
    return TrainedRun(
        str(plan.run), provenance.position.step, provenance.frames, provenance.data_sha256, provenance.best_miou
    )


def _frames(
    plan: TrainingPlan, exports: Sequence[Path], progress: Progress, wanted: WantedLabels
) -> tuple[CachedFrame, ...]:
    sources = labelled_frames(exports, wanted)
    return cached_frames(sources, plan.row.inputs, plan.cache or plan.run / "frames", progress)


def targets_of(frames: Sequence[CachedFrame], stride: int) -> tuple[int, ...]:
    """Return every `stride`-th labelled frame of each sequence, by index."""
    seen, targets = dict[str, int](), []
    for index, frame in enumerate(frames):
        if any(frame.voxels):
            count = seen.get(frame.sequence, 0)
            seen[frame.sequence] = count + 1
            if count % stride == 0:
                targets.append(index)
    return tuple(targets)


class _Run:
    """The loop over epochs and steps."""

    def __init__(
        self,
        plan: TrainingPlan,
        share: ProcessShare,
        state: TrainingState,
        frames: tuple[tuple[CachedFrame, ...], tuple[CachedFrame, ...]],
    ) -> None:
        self.plan, self.share, self.state, self.watched = plan, share, state, frames[1]
        self.config = plan.row.training
        indices = targets_of(frames[0], self.config.stride)
        self.sampler = EpochSampler(indices, self.config.seed, (share.rank, share.world))
        request = FrameRequest(
            plan.row.inputs,
            state.model.lattice,
            plan.row.augment,
            self.config.seed,
            self.config.counted,
            plan.row.label_grid,
        )
        self.loader: DataLoader[Batch] = DataLoader(
            FrameDataset(CachedStore(frames[0]), request),
            batch_size=self.config.batch,
            sampler=self.sampler,
            num_workers=plan.loaders,
            collate_fn=joined,
            drop_last=True,
            generator=torch.Generator(),  # its own generator: the model's is part of checkpoints
        )
        a_step = self.config.batch * self.config.accumulate
        if len(self.sampler) < a_step:
            raise Refused(
                "too_few_frames",
                f"each process has {len(self.sampler)} frames to train on, a step takes {a_step}: lower --batch, "
                "--accumulate or --stride, or give more exports",
            )
        self.steps_an_epoch = len(self.sampler) // a_step
        self.schedule = RateSchedule(self.config, self.steps_an_epoch * self.config.epochs)

    def train(self, reports: Reports) -> None:
        clock = RunClock(self.schedule.steps, self.state.provenance.position.step)
        with self._log() as write:

            def say(report: TrainingReport) -> None:
                write(report)
                reports(report)

            for epoch in range(self.state.provenance.position.epoch, self.config.epochs):
                for report in self._epoch(epoch, clock):
                    say(report)
                self._end_of(epoch, say)

    @contextmanager
    def _log(self) -> Iterator[Reports]:
        """Yield the target of reports: only the first process has one."""
        if not self.share.is_first:
            yield lambda report: None
            return
        with RunLog(self.plan.run, self.state.provenance.position.step) as log:
            yield log.write

    def _epoch(self, epoch: int, clock: RunClock) -> Iterator[TrainingReport]:
        """Yield a report for each remaining step of the epoch, before a checkpoint contains the step."""
        position = self.state.provenance.position
        self.sampler.epoch, self.sampler.begin = epoch, position.drawn
        self.state.model.train()
        batches = iter(self.loader)
        a_step = self.config.batch * self.config.accumulate
        for step in range(position.step, (epoch + 1) * self.steps_an_epoch):
            parts = [next(batches) for _ in range(self.config.accumulate)]
            report = self._step(step, parts)
            self.state.at(step=step + 1, epoch=epoch, drawn=self.sampler.begin + (step + 1 - position.step) * a_step)
            yield clock.stamped(replace(report, epoch=epoch), a_step * self.share.world)
            if (step + 1) % self.config.checkpoint_steps == 0:
                self._keep()

    def _step(self, step: int, parts: Sequence[Batch]) -> TrainingReport:
        terms, confusion = dict[str, float](), None
        for part in parts:
            batch = moved(part, self.share.device)
            measures = step % METRIC_EVERY == 0
            losses, logits = self.state.losses(batch, with_logits=measures)
            whole: Tensor = sum(losses.values(), batch.grid_from_ego.new_zeros(()))
            torch.autograd.backward(whole / len(parts))
            terms = {name: terms.get(name, 0.0) + float(value.detach()) / len(parts) for name, value in losses.items()}
            if logits is not None and batch.labels is not None:
                counts = confusion_of(logits, batch.labels)
                confusion = counts if confusion is None else confusion + counts
        rate = self.config.learning_rate * self.schedule.ratio(step)
        if not all(abs(value) < float("inf") for value in terms.values()):
            raise training_diverged(step, terms, rate)
        norm = take_step(self.state.parameters(), self.state.optimizer, rate, self.config.clip_norm)
        if not math.isfinite(norm):
            raise training_diverged(step, {**terms, "norm of gradients": norm}, rate)
        scores = {} if confusion is None else scores_of(confusion)
        return TrainingReport(step + 1, self.schedule.steps, 0, terms, scores, rate)

    def _end_of(self, epoch: int, say: Reports) -> None:
        """Score the validation data, keep the best weights, report, and start the next epoch."""
        scores, best = dict[str, float | None](), self.state.provenance.best_miou
        if self.watched:
            request = FrameRequest(
                self.plan.row.inputs,
                self.state.model.lattice,
                counted=self.config.counted,
                grid=self.plan.row.label_grid,
            )
            dataset = FrameDataset(CachedStore(self.watched), request)
            targets = targets_of(self.watched, self.config.stride)
            scores = scores_on(self.state.model, dataset, targets, (self.share.device, self.config.precision))
        reached = scores.get("miou")
        if reached is None or best is None or reached > best:
            self.state.provenance = replace(self.state.provenance, best_miou=best if reached is None else reached)
            if self.share.is_first:
                write_weights(self.plan.run, self.state.model, self.state.provenance)
        if self.watched:
            step = self.state.provenance.position.step
            say(TrainingReport(step, self.schedule.steps, epoch, scores=scores, watched=True))
        self.state.at(epoch=epoch + 1, drawn=0)
        self._keep()

    def _keep(self) -> None:
        if self.share.is_first:
            self.state.keep(self.plan.run)


# Scores of a model on frames outside its training data, by the platform's metric.


def scores_on(
    model: OccupancyModel[Any], dataset: FrameDataset, targets: Sequence[int], where: tuple[torch.device, str]
) -> dict[str, float | None]:
    """Return the ratios over all observed voxels of the frames `targets`; the model's training mode is restored."""
    device, precision = where
    whole, was_training = np.zeros((4, 4), np.int64), model.training
    model.eval()
    with torch.inference_mode():
        for index in targets:
            batch = moved(dataset[0, index], device)
            with torch.autocast(device.type, torch.bfloat16, enabled=precision == "bfloat16"):
                outputs = model(batch)
            if batch.labels is not None:
                whole += confusion_of(model.logits(outputs, batch), batch.labels)
    model.train(was_training)
    return scores_of(whole)


def training_diverged(step: int, terms: dict[str, float], rate: float) -> Refused:
    losses = ", ".join(f"{name} {value:.3g}" for name, value in terms.items())
    return Refused(
        "training_diverged",
        f"step {step}: the losses are {losses} at a learning rate of {rate:.2e}; lower learning_rate or "
        "clip_norm, or train in float32 (--precision float32); the last checkpoint is intact",
    )
