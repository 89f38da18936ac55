"""A digest covers all code that runs while a result is made: real runs are traced and compared with its reach.

The oracle is the interpreter's profiler: it notes each function that is entered.
"""

import ast
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from cProfile import Profile
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import CodeType

import numpy as np
import pytest

from services.domain.sequences.run_files import CHECKED_FILE, SEQUENCE_FILE
from services.eval.comparison.counting import counted_pairs
from services.eval.comparison.folders import open_folders
from services.eval.comparison.record import comparison_record
from services.eval.pipeline import score
from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sandboxed_synchronisation import (
    CheckRequest,
    StoredBags,
    SynchronisationRequest,
    check_left,
    synchronise_bags,
)
from services.labeler.exports.registry import EXPORTERS
from services.labeler.exports.sandboxed_export import ExportInputs, LabelRange, PackedLabels, write_format
from services.labeler.imports.indexing import index_dataset
from services.labeler.imports.scene_import import import_scene
from services.labeler.imports.scene_parts import DatasetOpening, SceneOpening
from services.labeler.kernel_warmup import warm
from services.labeler.map.map_files import MAP
from services.labeler.pipeline import label_graph
from services.labeler.publication_files import PUBLISHED
from services.labeler.results import load_pack, pack_path
from services.labeler.run import parts_of
from services.labeler.sandboxed_run import RunOpening, StageTask, described, planned, worked
from services.runtime.source_digests import LIBRARIES, NEUTRAL_LIBRARIES, OUTSIDE, ROOTS, ResultKind, reaches
from services.runtime.source_tree import Definition, SourceTree
from simulator.pipeline import calibration_path
from stone.sensors.sequence import frame_token
from stone_datasets.classes import OWN_CLASSES
from stone_files.npz import npz_bytes
from stone_recordings.sync.stored_recording import StoredRecording, StoredRecordingFile
from testing.worlds.brought_datasets import FIELD
from testing.worlds.drives import SHORT, drive
from testing.worlds.published_datasets import write_published_tar
from testing.worlds.submission_files import write_submission
from tests.services.eval.conftest import speckled

ROOT = Path(__file__).resolve().parents[3]
PLACES = {root: ROOT / root for root in ROOTS}
TREE = SourceTree(PLACES, OUTSIDE)
reached_by = cache(lambda: reaches(PLACES))


@contextmanager
def traced() -> Iterator[set[CodeType]]:
    """The functions that are entered meanwhile, in this thread and in those that it starts."""
    entered, profiles = set[CodeType](), list[Profile]()

    def begin(*_: object) -> None:
        """The first call in a thread: from here on its own profile notes the others, at little cost."""
        profiles.append(Profile(subcalls=False, builtins=False))
        profiles[-1].enable()

    threading.setprofile(begin)
    begin()
    try:
        yield entered
    finally:
        threading.setprofile(None)
        profiles[0].disable()
        noted = (entry.code for profile in profiles for entry in profile.getstats())
        entered |= {code for code in noted if isinstance(code, CodeType)}


def definitions_of(code: CodeType) -> set[Definition]:
    """The definitions of the platform whose statement holds this function; none if it is another's."""
    path = Path(code.co_filename)
    if not path.is_relative_to(ROOT) or path.relative_to(ROOT).parts[0] not in ROOTS or code.co_name == "<module>":
        return set()
    module = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    if not TREE.is_inside(module):
        return set()
    return {
        Definition(module, name)
        for name, statements in TREE.module(module).statements.items()
        for one in statements
        if first_line(one) <= code.co_firstlineno <= (one.end_lineno or 0)
    }


def first_line(statement: ast.stmt) -> int:
    decorators = getattr(statement, "decorator_list", [])
    return min([statement.lineno, *(one.lineno for one in decorators)])


def unreached(kind: ResultKind, entered: set[CodeType]) -> set[str]:
    """The functions that were entered and that the digest of this kind does not cover."""
    reached = reached_by()[kind].computations
    missed = set[str]()
    for code in entered:
        found = definitions_of(code)
        if found and not any(one in reached for one in found):
            missed.add(f"{min(found).module}:{code.co_qualname}")
    return missed


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    warm()
    return drive(tmp_path_factory, SHORT)


@pytest.fixture(scope="module")
def labelled(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[RunOpening, set[CodeType]]:
    """A run that is done, and the functions that were entered while its labels were made."""
    folder = tmp_path_factory.mktemp("run")
    kept = StoredRecording("run.mcap", (StoredRecordingFile("key", "run.mcap"),))
    bags = StoredBags((bag,), (kept,), {"run.mcap": "0" * 64}, {})
    asked = SynchronisationRequest(bags, calibration_path(bag), "run", (None, None), SynchroniseOptions())
    opening = RunOpening(folder, "local", {}, bag)
    with traced() as entered:
        synchronise_bags(asked, folder, silent)
        check_left(CheckRequest(folder, bag, (None, None)), folder, silent)
        planned(opening, folder, silent)
        for job in label_graph(opening.run())[:-1]:
            worked(StageTask(opening, job.kind, job.arguments), folder, silent)
        described(replace(opening, sequence_file=CHECKED_FILE), folder, silent)
    return opening, entered


def silent(_stage: str, _done: int, _total: int) -> None:
    """Progress that nothing shows."""


@pytest.mark.parametrize(
    ("definition", "kinds"),
    [
        (Definition("stone.labels.traversability", "FEW_VOXELS"), {"labels"}),
        (Definition("stone.kernels.column_words", "VECTOR"), {"scores", "comparisons"}),
        (Definition("services.labeler.exports.kitti", "QUARTER"), {"exports"}),
        (Definition("services.runtime.access.storage_quota", "balance"), set()),
    ],
)
def test_a_definition_counts_for_what_it_computes_and_for_nothing_else(definition: Definition, kinds: set[str]) -> None:
    assert definition.name in TREE.module(definition.module).statements
    assert {kind for kind, reach in reached_by().items() if definition in reach.computations} == kinds


def test_every_library_that_computes_is_counted_or_called_neutral() -> None:
    for kind, reach in reached_by().items():
        others = reach.libraries - set(sys.stdlib_module_names)
        assert others <= set(LIBRARIES) | NEUTRAL_LIBRARIES, f"{kind}: name them in services/runtime/source_digests.py"


@pytest.mark.whole
def test_all_that_makes_labels_is_reached(labelled: tuple[RunOpening, set[CodeType]]) -> None:
    _, entered = labelled
    assert len({one for code in entered for one in definitions_of(code)}) > 700
    assert unreached("labels", entered) == set()
    assert len(unreached("scores", entered)) > 500, "what makes no score is not reached by scores"


@pytest.mark.whole
def test_all_that_writes_exports_is_reached(
    labelled: tuple[RunOpening, set[CodeType]], bag: Path, tmp_path: Path
) -> None:
    """Catches alone an exporter that can change while its exports count as current."""
    opening, _ = labelled
    run, inputs = opening.run(), tmp_path / "inputs"
    inputs.mkdir()
    made = opening.folder
    for path in (made / SEQUENCE_FILE, *(made / PUBLISHED).iterdir(), *(made / MAP).iterdir()):
        if path.is_file():
            (inputs / path.name).symlink_to(path)
    tokens = iter(run.sequence.frames.tokens)
    ranges = tuple(
        LabelRange(next(tokens), pack_path(run, part).name, *at)
        for part in parts_of(run)
        for at in load_pack(run, part)[0].ranges()
    )
    packs = {pack_path(run, part).name: pack_path(run, part) for part in parts_of(run)}
    source = ExportInputs(inputs, PackedLabels(packs, ranges), bag)
    with traced() as entered:
        for form in EXPORTERS:
            (tmp_path / form / "files").mkdir(parents=True)
            write_format(form, source, tmp_path / form, silent)
    assert unreached("exports", entered) == set()


@pytest.mark.whole
def test_all_that_imports_a_dataset_is_reached(tmp_path: Path) -> None:
    tar, folder = write_published_tar(tmp_path / "field.tar", FIELD), tmp_path / "work"
    folder.mkdir()
    with traced() as entered:
        index_dataset(DatasetOpening(tar, "field", "0" * 64, OWN_CLASSES), folder, silent)
        import_scene(SceneOpening(tar, 0, OWN_CLASSES), folder, silent)
    assert unreached("imports", entered) == set()


@pytest.mark.whole
def test_all_that_scores_and_compares_is_reached(tmp_path: Path) -> None:
    labels = {frame_token("north", stamp_ns): speckled(stamp_ns) for stamp_ns in range(3)}
    for token, semantics in labels.items():
        file = tmp_path / "gts" / "north" / token / "labels.npz"
        file.parent.mkdir(parents=True)
        masks = dict.fromkeys(("mask_lidar", "mask_camera"), (semantics == 0).astype(np.uint8))
        file.write_bytes(npz_bytes({"semantics": semantics, **masks}))
    write_submission(tmp_path / "sub.zip", ((token, speckled(7)) for token in labels))
    with traced() as entered:
        record = score(tmp_path / "sub.zip", tmp_path, mask="lidar", threads=2).as_record()
    assert record["frames"] == len(labels)
    assert unreached("scores", entered) == set()
    folders = open_folders(tmp_path, tmp_path)
    with traced() as entered:
        comparison_record(folders.frames, counted_pairs(folders.pairs(), len(labels), folders.grid, silent))
    read_from_folders = ("services.eval.comparison.folders:", "stone_submissions.manifest:")
    assert {one for one in unreached("comparisons", entered) if not one.startswith(read_from_folders)} == set()
