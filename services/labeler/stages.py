"""What the labeler does in the queue, stage by stage; the science is the same that `pipeline.label` calls.

    parts → fuse (each part) → surface (each tile, when the parts that can reach it are fused), sight (each camera)
          → reference → frames (each part), map → publish

**Conventions.** A stage is a function of a `Desk`; it may run twice, at once or after being killed anywhere: its files
are renamed into place and have the same bytes. Jobs carry numbers only; everything else lies in the run's workspace.
"""

from collections.abc import Callable
from functools import partial

from services.labeler.comparison import comparison_path
from services.labeler.desk import Desk, desk_of
from services.labeler.errors import NoFramesError
from services.labeler.exporting import export
from services.labeler.frames import labelled_frames, lay_sight_lines
from services.labeler.fuse import fuse
from services.labeler.map_files import write_map
from services.labeler.phase_inputs import make_input
from services.labeler.plan import plan_of, surface_where_reached, tiles_around
from services.labeler.publishing import publish
from services.labeler.report import reference_from
from services.labeler.results import (
    index_path,
    load_reference,
    load_summaries,
    pack_path,
    reference_path,
    save_reference,
    save_summary,
    sums_path,
    write_pack,
)
from services.labeler.run import Part, Tile, neighbourhood
from services.labeler.scratch import images_path, sight_path, surface_path, tile_name
from services.runtime.benchmarks.inputs import INPUTS
from services.runtime.exports import EXPORT
from services.runtime.jobs.specs import Attempt, Handlers, JobSpec, Outcome
from services.runtime.platform import Platform
from services.runtime.processing import LABEL
from services.runtime.telemetry.meters import FRAMES
from services.runtime.telemetry.tallies import tallies

Stage = Callable[[Desk], Outcome]


def handlers(platform: Platform) -> Handlers:
    """The stages by kind."""
    stages: dict[str, Stage] = {
        LABEL: list_parts,
        "labeler.fuse": fuse_part,
        "labeler.surface": surface_tile,
        "labeler.sight": lay_sight,
        "labeler.reference": refer,
        "labeler.frames": label_part,
        "labeler.map": draw_map,
        "labeler.publish": publish,
    }
    made = {kind: partial(_at_a_desk, platform, stage) for kind, stage in stages.items()}
    return {**made, EXPORT: partial(export, platform), INPUTS: partial(make_input, platform)}


def list_parts(desk: Desk) -> Outcome:
    """All the jobs of the run, by its plan. Raises `NoFramesError`."""
    if len(desk.run.sequence.frames) == 0:
        raise NoFramesError(desk.run.sequence)
    plan = plan_of(desk.run)
    fused = {part: JobSpec("labeler.fuse", {"part": part}, key=f"fuse {part[0]}") for part in plan.parts}
    surfaces = [
        JobSpec("labeler.surface", {"tile": tile}, f"surface {tile_name(tile)}", tuple(fused[one].key for one in parts))
        for tile, parts in plan.needs.items()
    ]
    cameras = range(len(desk.run.sequence.calibration.of_kind("camera")))
    sights = [JobSpec("labeler.sight", {"camera": camera}, key=f"sight {camera}") for camera in cameras]
    reference = JobSpec("labeler.reference", key="reference", needs=tuple(spec.key for spec in (*surfaces, *sights)))
    drawn = JobSpec("labeler.map", key="map", needs=(reference.key,))
    frames = [
        JobSpec("labeler.frames", {"part": part}, key=f"frames {part[0]}", needs=(reference.key,))
        for part in plan.parts
    ]
    published = JobSpec("labeler.publish", needs=(drawn.key, *(spec.key for spec in frames)))
    jobs = (*surfaces, *fused.values(), *sights, reference, drawn, *frames, published)
    return Outcome({"parts": len(plan.parts), "tiles": len(surfaces)}, then=jobs)


def fuse_part(desk: Desk) -> Outcome:
    """Sweeps → point map, observed bricks and range images, per tile."""
    part = _part(desk)
    points = fuse(desk.run, part, desk.step("fuse"))
    fused = sorted((desk.run.scratch / "fused").glob(f"*_*/{part[0]:06d}.npz"))
    desk.push(*fused, images_path(desk.run, part))
    desk.attempt.log("fused", frames=part[1] - part[0], points=points, tiles=len(fused))
    return Outcome({"points": points})


def surface_tile(desk: Desk) -> Outcome:
    """Points of a tile and its neighbours → mesh, features, sums over what was driven; nothing where none fell."""
    i, j = desk.attempt.arguments["tile"]
    tile: Tile = (i, j)
    images = [f"images/{part[0]:06d}" for part in plan_of(desk.run).needs[tile]]
    desk.workspace.pull(*images, *(f"fused/{tile_name(near)}/" for near in neighbourhood(tile)))
    summary = surface_where_reached(desk.run, tile, desk.step("surface"))
    if summary is None:
        return Outcome({"voxels": 0})
    save_summary(desk.run, summary)
    desk.push(surface_path(desk.run, tile), sums_path(desk.run, tile))
    desk.attempt.log("reconstructed", tile=tile_name(tile), triangles=summary.triangles, driven=summary.sums.count)
    return Outcome({"voxels": summary.voxels})


def lay_sight(desk: Desk) -> Outcome:
    """What one camera can see."""
    camera = int(desk.attempt.arguments["camera"])
    desk.attempt.progress("sight", 0, 1)
    lay_sight_lines(desk.run, camera)
    desk.push(sight_path(desk.run, camera))
    return Outcome()


def refer(desk: Desk) -> Outcome:
    """Sums of all tiles → what driven ground is like. Raises `NoReferenceError`."""
    desk.workspace.pull("sums/")
    reference = reference_from(load_summaries(desk.run), desk.run.parameters)
    save_reference(desk.run, reference)
    desk.push(reference_path(desk.run))
    desk.attempt.log("reference", voxels=reference.voxels, is_floored=reference.is_floored)
    return Outcome({"voxels": reference.voxels})


def label_part(desk: Desk) -> Outcome:
    """The labelled map → the labels of the frames of a part, in one pack."""
    part = _part(desk)
    desk.pull(reference_path(desk.run).name)
    around = [surface_path(desk.run, tile) for tile in tiles_around(desk.run, part)]
    desk.workspace.pull("sight/", *(path.relative_to(desk.run.scratch).as_posix() for path in around))
    if not any(path.exists() for path in around):
        desk.pull("surface")
    reference = load_reference(desk.run)
    write_pack(desk.run, part, labelled_frames(desk.run, part, reference), desk.step("frames"))
    desk.push(pack_path(desk.run, part), index_path(desk.run, part))
    desk.attempt.log("labelled", frames=part[1] - part[0], pack_bytes=pack_path(desk.run, part).stat().st_size)
    tallies().add(FRAMES, ("labelled",), part[1] - part[0])
    return Outcome({"frames": part[1] - part[0]})


def draw_map(desk: Desk) -> Outcome:
    """The labelled map → its pictures and its mesh."""
    desk.pull(reference_path(desk.run).name, "surface", "sums")
    out = desk.run.scratch / "map"
    write_map(desk.run, load_summaries(desk.run), load_reference(desk.run), out, desk.step("map"))
    desk.push(out, comparison_path(desk.run))
    return Outcome()


def _at_a_desk(platform: Platform, stage: Stage, attempt: Attempt) -> Outcome:
    return stage(desk_of(platform, attempt))


def _part(desk: Desk) -> Part:
    begin, end = desk.attempt.arguments["part"]
    return begin, end
