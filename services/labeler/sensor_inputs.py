"""The stage that makes an input of a phase or of a dataset version: a synchronised sequence and what was measured →
files → packs in the store.

**Conventions.** As `services/labeler/export_stage.py`, but that labels, mesh and report are not even located: what is
not opened cannot get into what participants are given. Log lines and results say no more than names, files and bytes.
"""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

from services.domain.benchmarks.phases.inputs import phase_of_attempt, write_input
from services.domain.datasets.input_jobs import (
    InputResult,
    joined_key,
    sequence_key,
    version_of_attempt,
    write_version_input,
)
from services.domain.sequences.run_files import SEQUENCE_FILE
from services.labeler.export_stage import (
    INPUTS,
    ExportedLabels,
    ExportSandbox,
    attempt_folder,
    pack_files,
    stored_packs,
    with_samples,
)
from services.labeler.exports.sandboxed_export import FILES, ExportInputs, PackedLabels, write_phase_input
from services.runtime.jobs.specs import Attempt, Outcome
from services.runtime.platform import Platform
from services.runtime.store.pack_reading import archive_sha256, local_reader
from stone_files.joined_file import JOINED


def make_input(platform: Platform, attempt: Attempt) -> Outcome:
    """Write the input that the job is for.

    Raises `JobCancelledError` when its phase or version was deleted, `InputsImpossibleError`, `RecordingDeletedError`,
    and what the exporter raises.
    """
    is_of_version = "dataset_id" in attempt.arguments
    with platform.database.transaction() as session:
        version_of_attempt(session, attempt) if is_of_version else phase_of_attempt(session, attempt)
        keys = {SEQUENCE_FILE: sequence_key(session, attempt), JOINED: joined_key(session, attempt)}
    with attempt_folder(platform, attempt) as folder:
        made = _made(platform, attempt, keys, folder)
    attempt.log("made", name=made.name, files=len(made.files), tar_bytes=made.tar[0])
    result = {"name": made.name, "files": len(made.files), "tar_bytes": made.tar[0]}
    write = write_version_input if is_of_version else write_input
    return Outcome(result, commit=lambda session: write(session, attempt, made))


def _made(platform: Platform, attempt: Attempt, keys: Mapping[str, str | None], folder: Path) -> InputResult:
    """The files of the sequence, in the store; what it is made of lies under these keys, by name."""
    name = str(attempt.arguments["name"])
    (folder / INPUTS).mkdir()
    for called, key in keys.items():
        if key is not None:
            (folder / INPUTS / called).symlink_to(platform.store.local(key))
    sandbox, inputs = ExportSandbox(platform, attempt, folder), ExportInputs(folder / INPUTS, PackedLabels({}, ()))
    labels = ExportedLabels(str(attempt.arguments["label_set_id"]), str(attempt.arguments["sequence_id"]))
    inputs = with_samples(sandbox, inputs, labels)
    (folder / FILES).mkdir()
    sandbox.run(partial(write_phase_input, inputs), inputs)
    files = pack_files(attempt, folder)
    tar = archive_sha256(files, "tar", local_reader(folder / "packs"), partial(attempt.progress, "tar"))
    index, *packs = stored_packs(platform, attempt, folder, files)
    return InputResult(name, files, index, packs, tar)
