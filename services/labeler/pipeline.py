"""From a synchronised sequence to its labels: the page to read first.

    fuse (each part) → surface (each tile), sight (each camera) → reference → frames (each part), map, pictures
        → publish

`label_graph` says which jobs there are and what each waits for, `STAGES` what the jobs of a kind do: a function of the
run that finds and leaves files in scratch. `stone label` runs the jobs in a few processes
(`services/labeler/local_run.py`), the queue as tasks (`services/labeler/stages.py`); only publishing is each one's own.

**Conventions.** Parts are fused in the order of recording, and a tile is reconstructed as soon as the last part that
can reach it is fused (`services/labeler/plan.py`); the reference waits for all tiles, and the frames for the reference.
In the queue, publishing waits for the late checks of the sequence too.
"""

from collections.abc import Mapping

from services.labeler.map.map_files import draw_map, draw_pictures, files_of_map, files_of_pictures
from services.labeler.plan import plan_of
from services.labeler.run import LabelRun, Part
from services.labeler.scratch import tile_name
from services.labeler.stage import Stage
from services.labeler.stage_work import (
    files_of_frames,
    files_of_fuse,
    files_of_reference,
    files_of_sight,
    files_of_surface,
    fuse_part,
    label_part,
    lay_sight,
    refer,
    surface_tile,
)
from services.runtime.jobs.specs import JobSpec

FUSE, SURFACE, SIGHT = "labeler.fuse", "labeler.surface", "labeler.sight"
REFERENCE, FRAMES, PUBLISH = "labeler.reference", "labeler.frames", "labeler.publish"
MAP, PICTURES = "labeler.map", "labeler.pictures"
STAGES: Mapping[str, Stage] = {
    FUSE: Stage(fuse_part, files_of_fuse, "fuse", shown="fuse", event="fused", reads_sweeps=True),
    SURFACE: Stage(surface_tile, files_of_surface, "surface", shown="surface", event="reconstructed"),
    SIGHT: Stage(lay_sight, files_of_sight, "sight", shown="sight lines"),
    REFERENCE: Stage(refer, files_of_reference, "reference", event="reference"),
    FRAMES: Stage(label_part, files_of_frames, "frames", shown="frames", event="labelled"),
    MAP: Stage(draw_map, files_of_map, "map", shown="pictures"),
    PICTURES: Stage(draw_pictures, files_of_pictures, "pictures", shown="pictures"),
}


def label_graph(run: LabelRun) -> tuple[JobSpec, ...]:
    """All jobs of a run that has frames, in the order in which they may begin; publishing is the last."""
    plan = plan_of(run)
    cameras = range(len(run.sequence.calibration.of_kind("camera")))
    sights = [JobSpec(SIGHT, {"camera": camera}, f"sight {camera}") for camera in cameras]
    mapped = list[JobSpec]()
    for part in plan.parts:
        mapped.append(JobSpec(FUSE, {"part": part}, _fused(part)))
        for tile in (tile for tile, parts in plan.needs.items() if parts[-1] == part):
            waits = tuple(_fused(one) for one in plan.needs[tile])
            mapped.append(JobSpec(SURFACE, {"tile": tile}, f"surface {tile_name(tile)}", waits))
    before = tuple(job.key for job in (*mapped, *sights) if job.kind != FUSE)
    reference = JobSpec(REFERENCE, {}, "reference", before)
    drawn = [JobSpec(kind, {}, key, (reference.key,)) for kind, key in ((MAP, "map"), (PICTURES, "pictures"))]
    cut = [JobSpec(FRAMES, {"part": part}, f"frames {part[0]}", (reference.key,)) for part in plan.parts]
    published = JobSpec(PUBLISH, {}, "", tuple(job.key for job in (*drawn, *cut)))
    return (*mapped, *sights, reference, *drawn, *cut, published)


def _fused(part: Part) -> str:
    return f"fuse {part[0]}"
