"""Routes of a sequence's label sets: all of them, activation and deletion of one, and comparisons of two.

**Conventions.** Label sets that do not count any more are their owner's alone, and so are comparisons. Equal requests
are one comparison.
"""

from dataclasses import dataclass
from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response
from sqlalchemy import select

from api import audit
from api.answers import refusals
from api.deps import Caller, Curator, PlatformDep, Reader, at_once
from api.errors import NotFoundError
from api.etags import set_head
from api.files import GeneratedFile, answer_made, file_responses
from api.paging import Page, PageDep, page
from api.routes.sequences.frames import TokenPath
from api.schemas.base import IdPath
from api.schemas.sequences.label_sets import (
    LabelComparisonAccepted,
    LabelComparisonItem,
    LabelSetItem,
    NewLabelComparisonBody,
)
from api.views.jobs import job_items
from api.views.label_sets import comparison_items, frame_voxels_of, label_set_items, pair_differences, pair_picture
from api.views.scenes import ColoursQuery
from api.visible import label_comparison_of, label_set_of, sequence_of
from services.domain.sequences import label_set_activation
from services.domain.sequences.label_comparisons import StoredPair, start_comparison, stored_frame, stored_pair
from services.domain.sequences.label_set_deletion import delete_label_set
from services.domain.viewer.formats import MEDIA_TYPES
from services.runtime.orm import LabelComparison, LabelSet
from services.runtime.platform import Platform

router = APIRouter(prefix="/sequences/{sequence_id}", tags=["label sets"])
PNG, VOXELS, DIFFERENCES = "image/png", MEDIA_TYPES["STV1"], MEDIA_TYPES["STD1"]


@dataclass(frozen=True)
class ComparisonPath:
    """A comparison of a sequence's label sets, by ids."""

    sequence_id: IdPath
    comparison_id: IdPath


@dataclass(frozen=True)
class LabelSetPath:
    """A label set of a sequence, by ids."""

    sequence_id: IdPath
    label_set_id: IdPath


LabelSetAt = Annotated[LabelSetPath, Depends(at_once(LabelSetPath))]
AtComparison = Annotated[ComparisonPath, Depends(at_once(ComparisonPath))]


@router.get("/label-sets", responses=refusals(404))
def list_label_sets(sequence_id: IdPath, caller: Reader, platform: PlatformDep, query: PageDep) -> Page[LabelSetItem]:
    """List the label sets of a sequence, newest first; `is_counting` marks the active set."""
    with platform.database.reading() as session:
        sequence = sequence_of(session, caller, sequence_id)
        of_sequence = select(LabelSet).where(LabelSet.sequence_id == sequence.id)
        label_sets = page(session, of_sequence, LabelSet.id.desc(), query)
        return Page[LabelSetItem](items=label_set_items(session, sequence.id, label_sets.rows), next=label_sets.next)


@router.post("/label-sets/{label_set_id}/activate", responses=refusals(403, 404))
def activate_label_set(
    sequence_id: IdPath, label_set_id: IdPath, caller: Curator, platform: PlatformDep
) -> LabelSetItem:
    """Activate a label set: pages, exports and new dataset versions then use it."""
    with platform.database.transaction() as session:
        labels = label_set_of(session, caller, sequence_id, label_set_id)
        facts = {"sequence_id": labels.sequence_id, "recipe": labels.recipe}
        audit.record(session, caller, "label_set.activate", labels.id, facts=facts)
        label_set_activation.activate_label_set(session, labels)
        session.flush()
        return label_set_items(session, labels.sequence_id, [labels])[0]


@router.delete(
    "/label-sets/{label_set_id}", name="delete_label_set", status_code=204, responses=refusals(403, 404, 409)
)
def remove_label_set(sequence_id: IdPath, label_set_id: IdPath, caller: Curator, platform: PlatformDep) -> None:
    """Delete an unused label set; its comparisons, its playback and its storage are deleted too."""
    with platform.database.transaction() as session:
        labels = label_set_of(session, caller, sequence_id, label_set_id)
        facts = {"sequence_id": labels.sequence_id, "recipe": labels.recipe}
        audit.record(session, caller, "label_set.delete", labels.id, facts=facts)
        delete_label_set(session, labels)


@router.get(
    "/label-sets/{label_set_id}/frames/{token}/voxels",
    summary="Download a frame's voxels in any label set (STV1)",
    response_class=Response,
    responses=file_responses(VOXELS),
)
def download_label_set_voxels(
    at: LabelSetAt, token: TokenPath, caller: Reader, platform: PlatformDep, request: Request
) -> Response:
    """Return the class of each voxel and whether it was observed. The token may be that of the same frame in another
    set.
    """
    with platform.database.reading() as session:
        labels = label_set_of(session, caller, at.sequence_id, at.label_set_id)
        file = stored_frame(session, labels, token)
    if file is None:
        raise NotFoundError("frame of this label set", token)
    facts = GeneratedFile(VOXELS, f"{token}-voxels.bin", is_lasting=True)  # label sets never change
    return answer_made(request, frame_voxels_of(platform.store, file), facts)


@router.post("/label-comparisons", status_code=202, responses=refusals(403, 404, 409))
def create_label_comparison(
    sequence_id: IdPath, body: NewLabelComparisonBody, caller: Curator, platform: PlatformDep, response: Response
) -> LabelComparisonAccepted:
    """Compare two label sets; a failed comparison is tried again."""
    with platform.database.transaction() as session:
        sequence = sequence_of(session, caller, sequence_id)
        comparison, job = start_comparison(session, sequence, body.a_id, body.b_id)
        facts = {"sequence_id": sequence.id, "a_id": body.a_id, "b_id": body.b_id, "job_id": job.id}
        audit.record(session, caller, "label_comparison.create", comparison.id, facts=facts)
        item = comparison_items(session, [comparison])[0]
        shown = LabelComparisonAccepted(comparison=item, job=job_items(session, [job])[0])
    return set_head(response, shown, location=f"/api/v1/sequences/{sequence_id}/label-comparisons/{comparison.id}")


@router.get("/label-comparisons", responses=refusals(404))
def list_label_comparisons(
    sequence_id: IdPath, caller: Reader, platform: PlatformDep, query: PageDep
) -> Page[LabelComparisonItem]:
    """List the comparisons of a sequence's label sets, newest first."""
    with platform.database.reading() as session:
        sequence = sequence_of(session, caller, sequence_id)
        of_sequence = select(LabelComparison).where(LabelComparison.sequence_id == sequence.id)
        comparisons = page(session, of_sequence, LabelComparison.id.desc(), query)
        return Page[LabelComparisonItem](items=comparison_items(session, comparisons.rows), next=comparisons.next)


@router.get("/label-comparisons/{comparison_id}", summary="Show a comparison", responses=refusals(404))
def show_label_comparison(at: AtComparison, caller: Reader, platform: PlatformDep) -> LabelComparisonItem:
    """Show a comparison: its progress and result."""
    with platform.database.reading() as session:
        row = label_comparison_of(session, caller, at.sequence_id, at.comparison_id)
        return comparison_items(session, [row])[0]


@router.get(
    "/label-comparisons/{comparison_id}/frames/{token}.png",
    summary="Download the picture of a frame in both label sets",
    response_class=Response,
    responses=file_responses(PNG),
)
def download_label_difference(
    at: AtComparison,
    token: TokenPath,
    caller: Reader,
    platform: PlatformDep,
    request: Request,
    colours: ColoursQuery = "default",
) -> Response:
    """Return the labels from above: A, B, and their difference."""
    picture = pair_picture(platform.store, _pair(platform, caller, at, token), colours)
    return answer_made(request, picture, GeneratedFile(PNG, f"{token}-difference.png"))


@router.get(
    "/label-comparisons/{comparison_id}/frames/{token}/voxels",
    summary="Download the voxel differences of a frame (STD1)",
    response_class=Response,
    responses=file_responses(DIFFERENCES),
)
def download_difference_voxels(
    at: AtComparison, token: TokenPath, caller: Reader, platform: PlatformDep, request: Request
) -> Response:
    """Return the difference of each voxel between A and B, three bits each."""
    content = pair_differences(platform.store, _pair(platform, caller, at, token))
    return answer_made(request, content, GeneratedFile(DIFFERENCES, f"{token}-differences.bin"))


def _pair(platform: Platform, caller: Caller, at: ComparisonPath, token: str) -> StoredPair:
    """Return the label files of a frame in A and B. Raises `NotFoundError`."""
    with platform.database.reading() as session:
        row = label_comparison_of(session, caller, at.sequence_id, at.comparison_id)
        pair = stored_pair(session, row, token)
    if pair is None:
        raise NotFoundError("frame of this comparison", token)
    return pair
