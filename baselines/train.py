"""Training a row, from exports to weights. The page to read first.

    sources → cache → dataset → batches → losses → steps → checkpoint; what is watched → the best weights

**Conventions.** A run is a folder: `row.json`, `checkpoint.safetensors`, `weights.safetensors`, `log.jsonl`,
`tensorboard/`, and `frames/`, the cache, unless another is named. Killed at any moment it goes on from its checkpoint;
on a CPU the result is that of a run that never stopped, bit for bit.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor
from torch.utils.data import DataLoader

from baselines.batch import Batch, moved
from baselines.cache import CachedFrame, CachedStore, cached_frames
from baselines.checkpoint import load_backbone, write_weights
from baselines.collate import joined
from baselines.data import EpochSampler, FrameDataset, FrameRequest
from baselines.errors import TooFewFramesError, TooLittleMemoryError, TrainingDivergedError
from baselines.evaluation import scores_on
from baselines.metrics import confusion_of, scores_of
from baselines.optimisation import RateSchedule, take_step
from baselines.processes import ProcessShare, joined_processes
from baselines.row_config import RowConfig
from baselines.run_clock import RunClock
from baselines.run_folder import opened_run, say_row
from baselines.run_log import RunLog, TrainingReport
from baselines.sources import labelled_frames
from baselines.training_state import TrainingState, begun_state, resumed_state

METRIC_EVERY = 10  # steps
CPU_IS_FULL = "DefaultCPUAllocator: can't allocate memory"  # only of a GPU torch has an error of its own
Reports = Callable[[TrainingReport], None]
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class TrainingPlan:
    """What to train, on what, and where the run is.

    `watch`: exports that are scored after each epoch and never trained on; the weights are then those of the best
    epoch, else the last. `loaders`: processes that read frames; 0 reads them in the training process.
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
    """Where weights are, what they have seen, and the best score of what was watched."""

    run: str
    steps: int
    frames: int
    data_sha256: str
    best_miou: float | None


def train(plan: TrainingPlan, progress: Progress, reports: Reports) -> TrainedRun:
    """Train to the end of the plan, from the beginning or from the run's checkpoint.

    Raises what reading exports raises, `NothingToTrainOnError`, `RunExistsError`, `BadRunError`,
    `TooFewFramesError`, `TrainingDivergedError`, `TooLittleMemoryError`, `NoAcceleratorError`.
    """
    with joined_processes(plan.device) as share:
        row, goes_on = opened_run(plan.run, plan.row, plan.resume)
        share.wait()  # each has looked before one writes, or others would find a run that exists
        if share.is_first:
            say_row(plan.run, row)
        frames = _frames(plan, plan.exports, progress)
        watched = _frames(plan, plan.watch, progress) if plan.watch else ()
        state = begun_state(row, frames, share)
        if goes_on:
            state = resumed_state(plan.run, state)
        elif plan.backbone is not None:
            load_backbone(state.model, plan.backbone)
        try:
            _Run(plan, share, state, (frames, watched)).train(reports)
        except RuntimeError as error:
            if not isinstance(error, torch.OutOfMemoryError) and CPU_IS_FULL not in str(error):
                raise
            raise TooLittleMemoryError(str(share.device), row.training.batch) from error
    said = state.provenance
    return TrainedRun(str(plan.run), said.position.step, said.frames, said.data_sha256, said.best_miou)


def _frames(plan: TrainingPlan, exports: Sequence[Path], progress: Progress) -> tuple[CachedFrame, ...]:
    return cached_frames(labelled_frames(exports), plan.row.inputs, plan.cache or plan.run / "frames", progress)


def targets_of(frames: Sequence[CachedFrame], stride: int) -> tuple[int, ...]:
    """Of each sequence every `stride`-th frame that has labels, by index."""
    seen, targets = dict[str, int](), []
    for index, frame in enumerate(frames):
        if any(frame.voxels):
            place = seen.get(frame.sequence, 0)
            seen[frame.sequence] = place + 1
            if place % stride == 0:
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
            plan.row.inputs, state.model.lattice, plan.row.augment, self.config.seed, self.config.counted
        )
        self.loader: DataLoader[Batch] = DataLoader(
            FrameDataset(CachedStore(frames[0]), request),
            batch_size=self.config.batch,
            sampler=self.sampler,
            num_workers=plan.loaders,
            collate_fn=joined,
            drop_last=True,
            generator=torch.Generator(),  # one of its own: that of the model is part of checkpoints
        )
        a_step = self.config.batch * self.config.accumulate
        if len(self.sampler) < a_step:
            raise TooFewFramesError(len(self.sampler), a_step)
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
        """Where reports go: of the first process only."""
        if not self.share.is_first:
            yield lambda report: None
            return
        with RunLog(self.plan.run, self.state.provenance.position.step) as log:
            yield log.write

    def _epoch(self, epoch: int, clock: RunClock) -> Iterator[TrainingReport]:
        """Steps of what is left of the epoch, a report for each, said before a checkpoint has the step."""
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
            raise TrainingDivergedError(step, terms, rate)
        norm = take_step(self.state.parameters(), self.state.optimizer, rate, self.config.clip_norm)
        if not math.isfinite(norm):
            raise TrainingDivergedError(step, {**terms, "norm of gradients": norm}, rate)
        scores = {} if confusion is None else scores_of(confusion)
        return TrainingReport(step + 1, self.schedule.steps, 0, terms, scores, rate)

    def _end_of(self, epoch: int, say: Reports) -> None:
        """Score what is watched, keep the best weights, say so, and begin the next epoch."""
        scores, best = dict[str, float | None](), self.state.provenance.best_miou
        if self.watched:
            request = FrameRequest(self.plan.row.inputs, self.state.model.lattice, counted=self.config.counted)
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
