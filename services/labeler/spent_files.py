"""Files of a run that no further job reads: they are deleted during the run.

**Conventions.** Only tiles read the outputs of parts: range images, and points of a tile and its neighbours. A
succeeded tile job never runs again, and rows record its success, so a restarted job still finds its inputs.
"""

from sqlalchemy import select
from sqlalchemy.orm import aliased

from services.labeler.pipeline import FUSE, REFERENCE, SURFACE
from services.labeler.run import Tile, neighbourhood
from services.labeler.run_workspace import LabelStageContext
from services.labeler.scratch import FUSED, IMAGES, part_file, tile_name
from services.runtime.orm import Job, JobNeed

FREEING = (FUSE, REFERENCE)
"""The kinds of jobs that delete first: fusing for each part, and the reference after all tiles."""


def delete_spent(context: LabelStageContext) -> None:
    """Delete files that all their tiles have read; after the last tile, delete all."""
    tile, part = aliased(Job), aliased(Job)
    reads = (
        select(tile.state, tile.arguments, part.arguments)
        .join(JobNeed, JobNeed.job_id == tile.id)
        .join(part, part.id == JobNeed.needed_id)
        .where(tile.root_id == context.attempt.root_id, tile.kind == SURFACE)
    )
    with context.platform.database.reading() as session:
        rows = [
            (state == "succeeded", Tile(*arguments["tile"]), tuple(two["part"]))
            for state, arguments, two in session.execute(reads)
        ]
    waiting = {near for is_done, tile, _ in rows if not is_done for near in neighbourhood(tile)}
    images = {part_file(part) for _, _, part in rows} - {part_file(part) for is_done, _, part in rows if not is_done}
    folders = {tile_name(tile) for _, tile, _ in rows} - {tile_name(tile) for tile in waiting}
    if images:
        context.workspace.delete(f"{IMAGES}/", lambda name: not waiting or name.split("/")[1] in images)
    if folders:
        context.workspace.delete(f"{FUSED}/", lambda name: not waiting or name.split("/")[1] in folders)
