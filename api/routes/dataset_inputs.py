"""Routes of a version's inputs: create (administrators), list and download (signed-in users).

**Conventions.** An input is the nuScenes layout of one sequence of train or val without data made from labels, and
never changes. Its tar is generated on the fly and supports ranges, so that a download can resume. There are no inputs
of test.
"""

from typing import Annotated

from fastapi import APIRouter, Path, Request, Response

from api import audit
from api.answers import refusals
from api.deps import Administrator, PlatformDep, Reader
from api.errors import NotFoundError
from api.etags import set_head
from api.files import answer_bytes, file_responses
from api.paging import Page, PageDep, page
from api.schemas.admin import ReasonBody
from api.schemas.base import instant
from api.schemas.datasets import VERSION_PATTERN, DatasetInputItem, OpenPart
from api.schemas.jobs import JobDetail
from api.views.exports import served_archive
from api.views.jobs import job_detail
from api.visible import dataset_of
from services.domain.datasets.catalogue import OPEN
from services.domain.datasets.input_jobs import (
    MemberInput,
    inputs_of_members,
    located_input,
    members_of,
    start_version_inputs,
)
from services.runtime.orm import DatasetMember
from services.runtime.store.pack_reading import stored_files
from stone.sensors.sequence import NAME
from stone_files.archives import MEDIA_TYPES

router = APIRouter(tags=["dataset"])
DatasetName = Annotated[str, Path(pattern=VERSION_PATTERN, examples=["stone-1.0"])]
SequenceName = Annotated[str, Path(pattern=f"^{NAME.pattern}$", examples=["n-forest-07"])]
TAR = file_responses(MEDIA_TYPES["tar"])


@router.post(
    "/admin/datasets/{dataset_name}/inputs",
    summary="Create a dataset's missing inputs",
    status_code=202,
    responses=refusals(404, 409),
)
def create_dataset_inputs(
    dataset_name: DatasetName, body: ReasonBody, caller: Administrator, platform: PlatformDep, response: Response
) -> JobDetail:
    """Make the missing inputs of every sequence that still has its recording, by jobs. Publishing does it once."""
    with platform.database.transaction() as session:
        dataset = dataset_of(session, dataset_name)
        run = start_version_inputs(session, dataset, caller.user_id)
        audit.record_admin_act(session, caller, "dataset.inputs", dataset.id, body.reason, {"job_id": run.id})
        return set_head(response, job_detail(session, run), location=f"/api/v1/jobs/{run.id}")


@router.get(
    "/datasets/{dataset_name}/inputs", summary="List the available inputs of train and val", responses=refusals(404)
)
def list_dataset_inputs(
    dataset_name: DatasetName, _caller: Reader, platform: PlatformDep, query: PageDep
) -> Page[DatasetInputItem]:
    with platform.database.reading() as session:
        members = members_of(dataset_of(session, dataset_name).id, OPEN)
        members_page = page(session, members, DatasetMember.name, query)
        items = [_item(member_input) for member_input in inputs_of_members(session, members_page.rows)]
        return Page[DatasetInputItem](items=items, next=members_page.next)


@router.get(
    "/datasets/{dataset_name}/inputs/{sequence_name}.tar",
    summary="Download a sequence's inputs of the dataset (tar)",
    response_class=Response,
    responses=TAR,
)
@router.head(
    "/datasets/{dataset_name}/inputs/{sequence_name}.tar",
    summary="Show size and checksum of a sequence's inputs (dataset)",
    response_class=Response,
    responses=TAR,
    name="describe_dataset_input",
    description="Show size and checksum of a sequence's inputs (dataset).",
)
def download_dataset_input(
    dataset_name: DatasetName, sequence_name: SequenceName, _caller: Reader, platform: PlatformDep, request: Request
) -> Response:
    """Return the tar; supports ranges. `sha256sum.txt` in it contains the checksums of all other files."""
    with platform.database.reading() as session:
        row_and_input = located_input(session, dataset_of(session, dataset_name), sequence_name)
        if row_and_input is None:
            raise NotFoundError("input of this version", sequence_name)
    row, located = row_and_input
    stored = stored_files(platform.store, located)
    return answer_bytes(request, served_archive(platform.store, stored, "tar", (row.name, row.tar_sha256)))


def _item(one: MemberInput) -> DatasetInputItem:
    split: OpenPart = "train" if one.member.part == "train" else "val"
    made = one.made
    return DatasetInputItem(
        name=one.member.name,
        split=split,
        state=one.state,
        files=made.files if made else 0,
        size_bytes=made.size_bytes if made else 0,
        tar_bytes=made.tar_bytes if made else 0,
        tar_sha256=made.tar_sha256 if made else "",
        created_at=instant(made.created_ns) if made else None,
    )
