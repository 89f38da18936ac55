"""Labels of any parameters, remade from stored surfaces: a variant of the classes costs only the frames.

**Conventions.** Recordings, fused points and surfaces are stored in the folder, keyed by the parameters that they
depend on, but not by the code; `forget` them after a code change. No report is written.
"""

import os
import shutil
from collections.abc import Iterable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.outside.remedies import fault_of, opened
from benchmarks.outside.rows import Outcome, Row
from services.labeler.parameters import LabelParameters
from services.labeler.pipeline import FRAMES, FUSE, REFERENCE, STAGES, SURFACE, label_graph
from services.labeler.run import LabelRun, silent
from stone.errors import StoneError
from stone.labels.traversability import ReferenceParameters
from testing.outside.recording import recording_in
from testing.outside.verdict import judge_grids


def measure_variant(row: Row, folder: Path, parameters: LabelParameters) -> Outcome:
    """Return the outcome of a row's drive with these parameters instead of its profile's."""
    kept = kept_in(row, folder)
    if not (kept / "recording").exists():
        row.drive.record(folder, fault_of(row.fault), kept / "writing")
        (kept / "writing").rename(kept / "recording")
    sequence, sweeps = opened(row.fault, *recording_in(kept / "recording"))
    with TemporaryDirectory(dir=kept) as labels:
        run = LabelRun(sequence, sweeps, parameters, kept, Path(labels))
        try:
            run = replace(run, scratch=_surfaces(run))
            run_stages(run, (REFERENCE, FRAMES))
        except StoneError as error:
            return Outcome(0, {}, (), error.code)
        grids = [
            (Path(labels) / token / "labels.npz", int(stamp_ns))
            for token, stamp_ns in zip(sequence.frames.tokens, sequence.frames.stamps_ns, strict=True)
        ]
        verdict = judge_grids(grids, row.drive.truth, sequence.calibration.ego_from_lidar.as_matrix())
    return Outcome(verdict.frames, dict(verdict.counts), ())


def kept_in(row: Row, folder: Path) -> Path:
    """Return the folder of the recording and surfaces of a row's drive."""
    return folder / "kept" / f"{row.drive.name} {row.fault}"


def forget(folder: Path) -> None:
    """Delete the recordings and surfaces in a folder."""
    shutil.rmtree(folder / "kept", ignore_errors=True)


def _surfaces(run: LabelRun) -> Path:
    """Return the scratch with the run's surfaces, computed if they are missing; `run.scratch` contains the stored
    stages.
    """
    root, parameters = run.scratch, run.parameters
    of_points = (parameters.selection, parameters.tiling, parameters.carve, parameters.dynamic)
    fused = root / f"fused-{_hash((*of_points, parameters.surface.point_voxel_m))}"
    of_classes = replace(parameters, reference=ReferenceParameters(), confidence=False)
    surfaces = root / f"surfaces-{_hash(of_classes)}"
    if not fused.exists():
        _made(replace(run, scratch=root / "making"), fused, (FUSE,))
    if not surfaces.exists():
        shutil.rmtree(root / "making", ignore_errors=True)
        shutil.copytree(fused, root / "making", copy_function=os.link)
        _made(replace(run, scratch=root / "making"), surfaces, (SURFACE,))
    return surfaces


def _made(run: LabelRun, target: Path, kinds: Iterable[str]) -> None:
    run.scratch.mkdir(parents=True, exist_ok=True)
    run_stages(run, kinds)
    run.scratch.rename(target)


def run_stages(run: LabelRun, kinds: Iterable[str]) -> None:
    """Run the jobs of these kinds in this process, in their order."""
    for job in label_graph(run):
        if job.kind in kinds:
            STAGES[job.kind].work(run, job.arguments, silent)


def _hash(value: object) -> str:
    return sha256(repr(value).encode()).hexdigest()[:10]
