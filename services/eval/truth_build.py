"""The stage that builds a ground truth: the labels of one part of a dataset version → a pack, a manifest and facts.

**Conventions.** Only this stage reads the labels of test from a version, in a sandboxed child
(`services/eval/sandboxed_truth.py`); this process reads the platform's own index and moves files. Frames follow the
version's index; within a sequence they follow time. If the phase withholds the order, they follow the phase's tokens,
and the facts contain the place in time of each frame. A ready ground truth is never written again.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from secrets import token_hex
from typing import Any

from sqlalchemy import select, update
from sqlalchemy.orm import Session

from services.domain.benchmarks.phases.ground_truths import LABELS, first_activation
from services.domain.benchmarks.phases.unordered_frames import UnorderedFrames, unordered_frames
from services.eval.kernel_warmup import warm
from services.eval.sandboxed_truth import PACK, PackedLabelFile, TruthAnswer, TruthInputs, labels_unfit, write_truth
from services.eval.scoring_workspace import EvalStageContext
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.specs import Outcome
from services.runtime.orm import Blob, Dataset, DatasetMember, DatasetPack, DatasetPart, GroundTruthRow, Phase
from services.runtime.orm.base import now_ns
from services.runtime.sandbox import SandboxCrashedError
from services.runtime.sandbox.job_sandbox import JobSandbox
from services.runtime.store.blobs import PreparedBlob, link_all, prepare
from services.runtime.store.pack_reading import ExportLocation, StoredFiles, stored_files
from services.runtime.store.packs import PackedFiles
from services.runtime.store.protocol import Store
from stone_base.label_grid import PAPER, LabelGrid, recorded_grid
from stone_submissions.ground_truth import Mask
from stone_submissions.manifest import MAX_FRAMES, SEQUENCE_NAME, Manifest, is_token, write_manifest

MANIFEST = "manifest.json"


@dataclass(frozen=True)
class TruthSource:
    """The source of a ground truth: its mask and grid, and the location of the part's files.

    It has the facts about its sequences by name, and the selected frames (`unordered`; None for all, in time order).
    """

    mask: Mask
    grid: LabelGrid
    located: ExportLocation
    facts: Mapping[str, Mapping[str, Any]]
    unordered: UnorderedFrames | None


@dataclass(frozen=True)
class BuiltTruth:
    """A ground truth that is complete except for its row."""

    summary: TruthAnswer
    pack: PreparedBlob
    manifest: PreparedBlob
    facts: Mapping[str, Any]


def build_truth(context: EvalStageContext) -> Outcome:
    """Build the job's ground truth; the first of a phase becomes active.

    Raises `JobCancelledError` if the ground truth was deleted, `labels_unfit`, `SandboxCrashedError`,
    `SandboxInterruptedError`, and what the store raises.
    """
    truth_id = context.attempt.arguments["truth_id"]
    with context.platform.database.reading() as session:
        row = session.get(GroundTruthRow, truth_id)
        if row is None:
            raise JobCancelledError("its ground truth was deleted")
        if row.ready_ns is not None:
            return Outcome({"frames": row.frames})
        source = _source(session, row)
    built = _built(context, source)
    context.attempt.log("built", frames=built.summary.frames, sequences=len(built.facts["sequences"]))
    return Outcome({"frames": built.summary.frames}, commit=partial(_write, truth_id, built))


def _source(session: Session, truth: GroundTruthRow) -> TruthSource:
    part = session.get_one(DatasetPart, (truth.dataset_id, truth.part))
    packs = select(Blob.object_key).join(DatasetPack, DatasetPack.blob_sha256 == Blob.sha256)
    of_part = packs.where(DatasetPack.dataset_id == truth.dataset_id, DatasetPack.part == truth.part)
    located = ExportLocation(
        session.get_one(Blob, part.index_sha256).object_key,
        tuple(session.scalars(of_part.order_by(DatasetPack.ordinal))),
    )
    members = select(DatasetMember).where(
        DatasetMember.dataset_id == truth.dataset_id, DatasetMember.part == truth.part
    )
    facts = {
        row.name: {
            "name": row.name,
            "frames": row.frames,
            "environment": row.environment,
            "illumination": row.illumination,
            "region": row.region,
            "drive": row.drive,
            "first_stamp_ns": row.first_stamp_ns,
        }
        for row in session.scalars(members)
    }
    mask: Mask = truth.mask  # type: ignore[assignment]  # a phase has no other
    grid = recorded_grid(session.get_one(Dataset, truth.dataset_id).grid)
    phase = session.get_one(Phase, truth.phase_id)
    return TruthSource(mask, grid, located, facts, unordered_frames(phase.every_nth, phase.token_key))


def _built(context: EvalStageContext, source: TruthSource) -> BuiltTruth:
    store = context.platform.store
    inputs, places = _inputs(store, stored_files(store, source.located), source)
    folder = context.folder / f"truth-{token_hex(8)}"
    folder.mkdir()
    sandbox = JobSandbox(folder, tuple(inputs.packs.values()), context.attempt, context.platform.settings, warm)
    built = TruthAnswer.believed(sandbox.run(partial(write_truth, inputs), "truth", len(inputs.files)))
    if built.frames != len(inputs.files) or not (folder / PACK).is_file():
        raise SandboxCrashedError("built something other than requested")
    write_manifest(folder / MANIFEST, inputs.manifest)
    pack, listed = (prepare(store, context.platform.database, folder / name, adopt=True) for name in (PACK, MANIFEST))
    facts: dict[str, Any] = {"sequences": [dict(source.facts[name]) for name in inputs.manifest.sequences]}
    for of_sequence in facts["sequences"] if places else ():
        of_sequence |= {"frames": len(places[of_sequence["name"]]), "places": places[of_sequence["name"]]}
    if source.grid != PAPER:
        facts["grid"] = source.grid.as_record()
    return BuiltTruth(built, pack, listed, facts)


def _inputs(store: Store, stored: StoredFiles, source: TruthSource) -> tuple[TruthInputs, dict[str, list[int]]]:
    """Return the label files with their local packs, and each frame's place in time by sequence.

    The places are only given if frames are not in time order. Raises `labels_unfit`.
    """
    ordinals, manifest = _frames(stored, source.facts)
    places = dict[str, list[int]]()
    if source.unordered is not None:
        ordinals, manifest, places = _reorder_frames(ordinals, manifest, source.unordered)
    files = {token: _packed_file(stored.files, ordinal) for token, ordinal in ordinals.items()}
    packs = {
        number: store.local(stored.object_keys[number]) for number in sorted({file.pack for file in files.values()})
    }
    return TruthInputs(packs, files, replace(manifest, grid=source.grid), source.mask), places


def _packed_file(files: PackedFiles, ordinal: int) -> PackedLabelFile:
    number, offset, size = (int(of[ordinal]) for of in (files.packs, files.offsets_bytes, files.sizes_bytes))
    return PackedLabelFile(files.names[ordinal], number, offset, size, files.digest(ordinal))


def _frames(stored: StoredFiles, facts_by_name: Mapping[str, Mapping[str, Any]]) -> tuple[dict[str, int], Manifest]:
    """Return the index position of each frame's label file, by token, and the manifest. Raises `labels_unfit`."""
    ordinals: dict[str, int] = {}
    sequences: dict[str, list[str]] = {}
    for ordinal, name in enumerate(stored.files.names):
        if not name.startswith(LABELS):
            continue
        _, sequence, token, file = name.split("/")
        if not (is_token(token) and SEQUENCE_NAME.fullmatch(sequence) and file == "labels.npz") or token in ordinals:
            raise labels_unfit(f"file {name[:300]!r}", "it is not the only label file of a frame")
        ordinals[token] = ordinal
        sequences.setdefault(sequence, []).append(token)
    counted = {name: len(tokens) for name, tokens in sequences.items()}
    if (
        counted != {name: facts["frames"] for name, facts in facts_by_name.items()}
        or not 0 < len(ordinals) <= MAX_FRAMES
    ):
        raise labels_unfit("the sequences", f"their {len(ordinals)} frames differ from the frames in the database")
    return ordinals, Manifest({name: tuple(tokens) for name, tokens in sequences.items()})


def _reorder_frames(
    ordinals: Mapping[str, int], manifest: Manifest, chosen: UnorderedFrames
) -> tuple[dict[str, int], Manifest, dict[str, list[int]]]:
    """Return ordinals and manifest of the chosen frames under their phase tokens, and each frame's place in time."""
    frames = {name: chosen.of(tokens) for name, tokens in manifest.sequences.items()}
    places = {name: [at for _, at in of_sequence] for name, of_sequence in frames.items()}
    files = {token: ordinals[manifest.sequences[name][at]] for name, pairs in frames.items() for token, at in pairs}
    return files, Manifest({name: tuple(token for token, _ in pairs) for name, pairs in frames.items()}), places


def _write(truth_id: str, built: BuiltTruth, session: Session) -> None:
    """Complete the row, once; the first ground truth of a phase becomes active."""
    link_all(session, (built.pack, built.manifest))
    unready = update(GroundTruthRow).where(GroundTruthRow.id == truth_id, GroundTruthRow.ready_ns.is_(None))
    made = unready.values(
        sha256=built.summary.sha256,
        frames=built.summary.frames,
        manifest_sha256=built.manifest.sha256,
        pack_sha256=built.pack.sha256,
        facts=dict(built.facts),
        ready_ns=now_ns(),
    )
    session.execute(made, execution_options={"synchronize_session": False})
    first_activation(session, session.get_one(GroundTruthRow, truth_id, populate_existing=True))
