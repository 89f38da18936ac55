"""What the stages do: a function each of a run, a job's arguments and a progress; beside it the files of that job.

**Conventions.** Each may run twice, at once or after being killed anywhere: its files are renamed into place and have
the same bytes. It finds what it needs in scratch and leaves there what others need, so it does not matter which
process it runs in.
"""

from pathlib import Path

from services.labeler.frames import compute_sight_lines, labelled_frames
from services.labeler.map.far_points import far_points_path
from services.labeler.map.fuse import fuse
from services.labeler.plan import plan_of, surface_where_reached, tiles_around
from services.labeler.results import (
    index_path,
    load_reference,
    load_summaries,
    pack_path,
    reference_from,
    reference_path,
    save_reference,
    save_summary,
    sums_path,
    write_labels,
)
from services.labeler.run import LabelRun, Part, Step, neighbourhood, require_ground
from services.labeler.scratch import images_path, sight_path, surface_path, tile_name
from services.labeler.stage import Arguments, StageFiles, StageResult, part_of, tile_of


def fuse_part(run: LabelRun, arguments: Arguments, step: Step) -> StageResult:
    """Sweeps → point map, observed bricks and range images, per tile. Raises `FootprintOffGroundError`."""
    require_ground(run)
    part = part_of(arguments)
    points = fuse(run, part, step)
    tiles = sum(1 for _ in run.scratch.glob(_fused(part)))
    return StageResult({"points": points}, {"frames": part[1] - part[0], "points": points, "tiles": tiles})


def files_of_fuse(run: LabelRun, arguments: Arguments) -> StageFiles:
    part = part_of(arguments)
    beside = (images_path(run, part), far_points_path(run, part))
    return StageFiles(writes=(_fused(part), *(_name(run, path) for path in beside)))


def surface_tile(run: LabelRun, arguments: Arguments, step: Step) -> StageResult:
    """Points of a tile and its neighbours → mesh, features, sums over what was driven; nothing where none fell."""
    summary = surface_where_reached(run, tile_of(arguments), step)
    if summary is None:
        return StageResult({"voxels": 0})
    save_summary(run, summary)
    facts = {"tile": tile_name(summary.tile), "triangles": summary.triangles, "driven": summary.sums.count}
    return StageResult({"voxels": summary.voxels}, facts)


def files_of_surface(run: LabelRun, arguments: Arguments) -> StageFiles:
    tile = tile_of(arguments)
    images = (f"images/{part[0]:06d}" for part in plan_of(run).needs[tile])
    fused = (f"fused/{tile_name(near)}/" for near in neighbourhood(tile))
    left = (_name(run, path) for path in (surface_path(run, tile), sums_path(run, tile)))
    return StageFiles(reads=(*images, *fused), writes=tuple(left))


def lay_sight(run: LabelRun, arguments: Arguments, step: Step) -> StageResult:
    """What one camera can see."""
    step(0, 1)
    compute_sight_lines(run, int(arguments["camera"]))
    return StageResult()


def files_of_sight(run: LabelRun, arguments: Arguments) -> StageFiles:
    return StageFiles(writes=(_name(run, sight_path(run, int(arguments["camera"]))),))


def refer(run: LabelRun, _arguments: Arguments, _step: Step) -> StageResult:
    """Sums of all tiles → what driven ground is like. Raises `NoReferenceError`."""
    reference = reference_from(load_summaries(run), run.parameters)
    save_reference(run, reference)
    return StageResult({"voxels": reference.voxels}, {"voxels": reference.voxels, "is_floored": reference.is_floored})


def files_of_reference(run: LabelRun, _arguments: Arguments) -> StageFiles:
    return StageFiles(reads=("sums/",), writes=(_name(run, reference_path(run)),))


def label_part(run: LabelRun, arguments: Arguments, step: Step) -> StageResult:
    """The labelled map → the labels of the frames of a part."""
    part = part_of(arguments)
    index = write_labels(run, part, labelled_frames(run, part, load_reference(run)), step)
    frames = part[1] - part[0]
    return StageResult({"frames": frames}, {"frames": frames, "pack_bytes": index.size_bytes})


def files_of_frames(run: LabelRun, arguments: Arguments) -> StageFiles:
    part, reference = part_of(arguments), _name(run, reference_path(run))
    around = (_name(run, surface_path(run, tile)) for tile in tiles_around(run, part))
    left = (_name(run, path) for path in (pack_path(run, part), index_path(run, part)))
    return StageFiles((reference, "sight/", *around), (reference, "surface"), tuple(left))


def _fused(part: Part) -> str:
    """The pattern of what a part leaves, a file each tile."""
    return f"fused/*_*/{part[0]:06d}.npz"


def _name(run: LabelRun, path: Path) -> str:
    return path.relative_to(run.scratch).as_posix()
