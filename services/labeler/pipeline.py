"""From a synchronised sequence to its labels. Start reading here.

    fuse (each part) → surface (each tile) → reference → frames (each part), map, pictures
        → publish

`label_graph` lists the jobs and their dependencies. `STAGES` defines the jobs of a kind: a function of a run, the job's
arguments and a progress callback, and the files in scratch that the function reads. `stone label` runs the jobs in a
few processes (`services/labeler/local_run.py`), the queue as tasks (`services/labeler/queue_handlers.py`); each has its
own publishing.

**Conventions.** Parts are fused in the order of recording, and a tile is reconstructed as soon as the last part that
can reach it is fused (`services/labeler/tile_plan.py`). The reference needs all tiles, and the frames need the
reference. In the queue, publishing also needs the late checks of the sequence.

A stage may run twice, concurrently or after being killed anywhere: its files are renamed into place and have the same
bytes. Stages exchange all data through scratch, so any process may run a stage.
"""

from collections.abc import Mapping
from pathlib import Path

from services.labeler.frames import labelled_frames
from services.labeler.map.fuse import fuse
from services.labeler.map.map_files import draw_map, draw_pictures
from services.labeler.map.surface import TileSummary, surface
from services.labeler.results import (
    REFERENCE_FILE,
    load_reference,
    load_summaries,
    reference_from,
    save_reference,
    save_summary,
    write_labels,
)
from services.labeler.run import LabelRun, Part, Step, Tile, neighbourhood, require_ground, silent
from services.labeler.scratch import images_path, surface_path, tile_name
from services.labeler.stage import Arguments, Stage, StageResult, part_of, tile_of
from services.labeler.tile_plan import plan_of, tiles_around
from services.runtime.jobs.specs import JobSpec


def fuse_part(run: LabelRun, arguments: Arguments, step: Step) -> StageResult:
    """Make point map, observed bricks and range images of each tile from the sweeps."""
    part = part_of(arguments)
    points = fuse(run, part, step)
    tiles = sum(1 for _ in run.scratch.glob(f"fused/*_*/{part[0]:06d}.npz"))
    return StageResult({"points": points}, {"frames": part[1] - part[0], "points": points, "tiles": tiles})


def surface_tile(run: LabelRun, arguments: Arguments, step: Step) -> StageResult:
    """Make mesh, features and sums over driven voxels from points around a tile; nothing without points."""
    summary = surface_where_reached(run, tile_of(arguments), step)
    if summary is None:
        return StageResult({"voxels": 0})
    save_summary(run, summary)
    facts = {"tile": tile_name(summary.tile), "triangles": summary.triangles, "driven": len(summary.driven)}
    return StageResult({"voxels": summary.voxels}, facts)


def surface_where_reached(run: LabelRun, tile: Tile, step: Step = silent) -> TileSummary | None:
    """Return the surface of a planned tile, or None if no part has data there."""
    return surface(run, tile, step) if (run.scratch / "fused" / tile_name(tile)).is_dir() else None


def list_fused_around(run: LabelRun, arguments: Arguments) -> tuple[str, ...]:
    """Return the files that `surface_tile` reads."""
    tile = tile_of(arguments)
    images = (_name(run, images_path(run, part)) for part in plan_of(run).needs[tile])
    return (*images, *(f"fused/{tile_name(near)}/" for near in neighbourhood(tile)))


def refer(run: LabelRun, _arguments: Arguments, _step: Step) -> StageResult:
    """Make the reference of driven ground from the sums of all tiles. Raises `no_reference`."""
    reference = reference_from(run, load_summaries(run))
    save_reference(run, reference)
    return StageResult({"voxels": reference.voxels}, {"voxels": reference.voxels, "is_floored": reference.is_floored})


def label_part(run: LabelRun, arguments: Arguments, step: Step) -> StageResult:
    """Make the labels of a part's frames from the labelled map."""
    part = part_of(arguments)
    index = write_labels(run, part, labelled_frames(run, part, load_reference(run)), step)
    frames = part[1] - part[0]
    return StageResult({"frames": frames}, {"frames": frames, "pack_bytes": index.size_bytes})


def list_surfaces_around(run: LabelRun, arguments: Arguments) -> tuple[str, ...]:
    """Return the surfaces that `label_part` reads."""
    return tuple(_name(run, surface_path(run, tile)) for tile in tiles_around(run, part_of(arguments)))


def _name(run: LabelRun, path: Path) -> str:
    return path.relative_to(run.scratch).as_posix()


FUSE, SURFACE, REFERENCE = "labeler.fuse", "labeler.surface", "labeler.reference"
FRAMES, MAP, PICTURES, PUBLISH = "labeler.frames", "labeler.map", "labeler.pictures", "labeler.publish"
CUT_FROM = (REFERENCE_FILE, "surface")
DRAWN_FROM = (*CUT_FROM, "sums")
STAGES: Mapping[str, Stage] = {
    FUSE: Stage(fuse_part, "fuse", shown="fuse", event="fused", reads_sweeps=True),
    SURFACE: Stage(surface_tile, "surface", list_fused_around, shown="surface", event="reconstructed"),
    REFERENCE: Stage(refer, "reference", reads=("sums/",), event="reference"),
    FRAMES: Stage(
        *(label_part, "frames", list_surfaces_around),
        reads=(REFERENCE_FILE,),
        requires=CUT_FROM,
        shown="frames",
        event="labelled",
    ),
    MAP: Stage(draw_map, "map", reads=DRAWN_FROM, requires=DRAWN_FROM, shown="pictures"),
    PICTURES: Stage(draw_pictures, "pictures", reads=DRAWN_FROM, requires=DRAWN_FROM, shown="pictures"),
}


def label_graph(run: LabelRun) -> tuple[JobSpec, ...]:
    """Return all jobs of a run with frames, in the order of their earliest start; publishing is the last.

    Raises as `require_ground`: a run whose labels would be wrong is not started.
    """
    require_ground(run)
    plan = plan_of(run)
    mapped = list[JobSpec]()
    for part in plan.parts:
        mapped.append(JobSpec(FUSE, {"part": part}, _fused(part)))
        for tile in (tile for tile, parts in plan.needs.items() if parts[-1] == part):
            waits = tuple(_fused(needed) for needed in plan.needs[tile])
            mapped.append(JobSpec(SURFACE, {"tile": tile}, f"surface {tile_name(tile)}", waits))
    before = tuple(job.key for job in mapped if job.kind != FUSE)
    reference = JobSpec(REFERENCE, {}, "reference", before)
    drawn = [JobSpec(kind, {}, key, (reference.key,)) for kind, key in ((MAP, "map"), (PICTURES, "pictures"))]
    cut = [JobSpec(FRAMES, {"part": part}, f"frames {part[0]}", (reference.key,)) for part in plan.parts]
    published = JobSpec(PUBLISH, {}, "", tuple(job.key for job in (*drawn, *cut)))
    return (*mapped, reference, *drawn, *cut, published)


def _fused(part: Part) -> str:
    return f"fuse {part[0]}"
