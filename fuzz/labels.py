"""Labelling as a target: a short drive with values from the bytes, through all steps of `stone label`.

**Conventions.** It runs in one process, with the indices of all kernels checked. `NUMBA_BOUNDSCHECK` must be set before
numba is loaded, with a cache of its own, since numba takes unchecked code from a cache for checked.
"""

import math
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sequence import opened_sequence
from services.labeler.errors import no_usable_frames
from services.labeler.local_run import tasks_of
from services.labeler.parameters import LabelParameters, parameters_for
from services.labeler.report import LabelReport, report_of
from services.labeler.results import load_pack
from services.labeler.run import LabelRun, parts_of
from testing.worlds.hostile_drive import ATTACKS, Arrays, attacked, edit_bytes, edits_in, write_drive


class WrongLabelsError(AssertionError):
    """The labels are invalid."""


def label_seeds() -> Iterator[tuple[str, bytes]]:
    """Yield the sound drive, and a drive with each kind of value in a position that once caused a fault, or could."""
    yield "sound", b""
    for name, edits in ATTACKS.items():
        yield name.replace(" ", "-"), edit_bytes(*edits)


def read_and_label(content: bytes) -> None:
    """Label a drive with the edits of the bytes; a calculation with a numpy warning is a crash."""
    with TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        labelled(attacked(*edits_in(content)), Path(folder))


def labelled(arrays: Arrays, folder: Path) -> LabelReport:
    """Return the report of the drive's labels, made in this process. Raises any refusal."""
    bag, calibration = write_drive(arrays, folder)
    with opened_sequence(bag, calibration, "run", SynchroniseOptions(ground="given")) as opened:
        if len(opened.sequence.frames) == 0:
            raise no_usable_frames(opened.sequence)
        findings = (*opened.sequence.findings, *opened.late_findings())
        sequence = replace(opened.sequence, inputs=opened.recording_inputs(), findings=findings)
        run = LabelRun(sequence, opened.sweeps, parameters(), folder / "scratch")
        for task in tasks_of(run):
            task.call(*task.arguments)
    return checked(run)


def parameters() -> LabelParameters:
    return replace(parameters_for("local"), confidence=True)


def checked(run: LabelRun) -> LabelReport:
    """Return the report. Raises `WrongLabelsError` if a number is invalid or labels and frames do not match."""
    report = report_of(run)
    labels = sum(len(load_pack(run, part)[0].ends_bytes) for part in parts_of(run))
    if not 0 < labels == len(run.sequence.frames):
        raise WrongLabelsError(f"{labels} labels of {len(run.sequence.frames)} frames")
    if not all(math.isfinite(number) for number in _numbers(report.as_record())):
        raise WrongLabelsError(f"the report contains an invalid number: {report.text()}")
    return report


def _numbers(record: object) -> list[float]:
    if isinstance(record, dict):
        return [number for value in record.values() for number in _numbers(value)]
    if isinstance(record, list | tuple):
        return [number for value in record for number in _numbers(value)]
    return [record] if isinstance(record, float) else []
