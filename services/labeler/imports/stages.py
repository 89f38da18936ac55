"""What the labeler does for an import of a dataset: three stages, as handlers by kind.

    ingest keeps the tar → index → import (each scene) → publish (all of them at once)

**Conventions.** As of `services/labeler/stages.py`: a stage may run twice, at once or after being killed anywhere. A
dataset comes from a stranger, so it is opened in a sandboxed child alone, and a scene that is done is never done again.
"""

from collections.abc import Callable
from functools import partial

from services.domain.imports.requests import INDEX, PUBLISH_IMPORT, SCENE
from services.labeler.imports.index_stage import index_tar
from services.labeler.imports.publish_stage import publish_scenes
from services.labeler.imports.scene_stage import import_one_scene
from services.labeler.imports.stage_context import ImportStageContext, import_context_of
from services.runtime.jobs.specs import Attempt, Handlers, Outcome
from services.runtime.platform import Platform

STAGES = {INDEX: index_tar, SCENE: import_one_scene, PUBLISH_IMPORT: publish_scenes}


def import_handlers(platform: Platform) -> Handlers:
    """The stages by kind."""
    return {kind: partial(_with_context, platform, stage) for kind, stage in STAGES.items()}


def _with_context(platform: Platform, stage: Callable[[ImportStageContext], Outcome], attempt: Attempt) -> Outcome:
    return stage(import_context_of(platform, attempt))
