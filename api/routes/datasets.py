"""Routes of dataset versions: publish (administrators), read and download (signed-in users).

**Conventions.** A version never changes, so its manifest and archives can be cached for ever. Archives are generated on
the fly and support ranges. No response contains the labels of test, and there is no route to them.
"""

from pathlib import Path as FilePath
from tempfile import TemporaryDirectory
from typing import Annotated

from fastapi import APIRouter, Path, Request, Response
from sqlalchemy import select

from api import audit
from api.answers import refusals
from api.deps import Administrator, PlatformDep, Reader
from api.etags import require_match, set_head
from api.files import ServedFile, StoredFile, answer_bytes, answer_file, file_responses
from api.lists.answers import listed, model_response
from api.paging import Page, PageDep, page
from api.row_readers import by_row_readers
from api.schemas.datasets import VERSION_PATTERN, DatasetDetail, DatasetItem, NewDatasetBody, OpenPart, PublishedDataset
from api.views.datasets import dataset_detail, dataset_item
from api.views.splits import rule_items
from api.visible import dataset_of
from services.domain.datasets.input_jobs import follow_publication
from services.domain.datasets.queries import locate_part
from services.domain.datasets.versions import NewDataset, prepare_dataset, write_dataset
from services.runtime.orm import Blob, Dataset
from services.runtime.store.pack_reading import archive_of, archive_pieces, stored_files
from stone_files.archives import MEDIA_TYPES

router = APIRouter(prefix="/datasets", tags=["dataset"])
DatasetName = Annotated[str, Path(pattern=VERSION_PATTERN, examples=["stone-1.0"])]
MANIFEST = file_responses("application/json")
ARCHIVE = file_responses(MEDIA_TYPES["tar"])


@router.post("", summary="Publish the draft splits as a version", status_code=201, responses=refusals(409, 412))
def create_dataset(
    body: NewDatasetBody, caller: Administrator, platform: PlatformDep, request: Request, response: Response
) -> PublishedDataset:
    """Publish a version that never changes. Its train and val parts can then be downloaded.

    Jobs then make the inputs. The response contains the warnings of the rules, and the audit log their codes. With
    If-Match, the ETag of the splits, the request fails if the splits have changed since.
    """
    new_dataset = NewDataset(body.name, body.licence, caller.user_id)
    platform.settings.root.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=platform.settings.root) as folder:
        prepared = prepare_dataset(platform, new_dataset, FilePath(folder))
        if "if-match" in request.headers:
            require_match(request, prepared.revision)
        with platform.database.transaction() as session:
            dataset = write_dataset(session, prepared)
            follow_publication(session, dataset, caller.user_id)
            warned = sorted({finding.code for finding in prepared.warnings})
            facts = {"name": dataset.name, "manifest_sha256": dataset.manifest_sha256, "warnings": warned}
            audit.record_admin_act(session, caller, "dataset.create", dataset.id, body.reason, facts)
            shown = dataset_detail(session, dataset)
    published = PublishedDataset(**dict(shown), findings=rule_items(prepared.warnings))
    return set_head(response, published, tag=dataset.manifest_sha256, location=f"/api/v1/datasets/{dataset.name}")


@router.get("", response_model=Page[DatasetItem], responses=listed())
@by_row_readers
def list_datasets(_caller: Reader, platform: PlatformDep, query: PageDep, request: Request) -> Response:
    """List the dataset versions, newest first."""
    with platform.database.lookups() as session:
        datasets = page(session, select(Dataset), Dataset.id.desc(), query)
        shown = Page[DatasetItem](items=[dataset_item(session, row) for row in datasets.rows], next=datasets.next)
    return model_response(request, shown)


@router.get("/{dataset_name}", summary="Show a version with its sequences and downloads", responses=refusals(404))
def show_dataset(
    dataset_name: DatasetName, _caller: Reader, platform: PlatformDep, response: Response
) -> DatasetDetail:
    """Show a version with its sequences and downloads."""
    with platform.database.reading() as session:
        dataset = dataset_of(session, dataset_name)
        return set_head(response, dataset_detail(session, dataset), tag=dataset.manifest_sha256)


@router.get(
    "/{dataset_name}/manifest", summary="Download a version's manifest", response_class=Response, responses=MANIFEST
)
def download_dataset_manifest(
    dataset_name: DatasetName, _caller: Reader, platform: PlatformDep, request: Request
) -> Response:
    """Return the sequences, the statistics, and every file of train and val with its sha256."""
    with platform.database.reading() as session:
        row = dataset_of(session, dataset_name)
        blob = session.get_one(Blob, row.manifest_sha256)
    named = f"{row.name}.manifest.json"
    file = StoredFile(blob.object_key, row.manifest_bytes, row.manifest_sha256, "application/json", named)
    return answer_file(request, platform.store, file)


@router.get(
    "/{dataset_name}/archives/{part}",
    summary="Download train or val as a tar",
    response_class=Response,
    responses=ARCHIVE,
)
def download_dataset_part(
    dataset_name: DatasetName, part: OpenPart, _caller: Reader, platform: PlatformDep, request: Request
) -> Response:
    """Return the tar; supports ranges. `sha256sum.txt` in it contains the checksums of all other files."""
    with platform.database.reading() as session:
        row, located = locate_part(session, dataset_of(session, dataset_name), part)
    stored = stored_files(platform.store, located)
    archive, read = archive_of(stored.files, "tar"), stored.reader(platform.store)
    served = ServedFile(
        size_bytes=archive.size_bytes,
        sha256=row.tar_sha256,
        media_type=MEDIA_TYPES["tar"],
        filename=f"{dataset_name}-{part}.tar",
        read=lambda start, stop: archive_pieces(stored.files, archive, (start, stop), read),
        object_keys=stored.object_keys,
    )
    return answer_bytes(request, served)
