"""Routes of imports of published datasets: start an import from an upload or in place, follow it, delete it.

**Conventions.** The dataset is one archive: an upload of purpose `dataset`, or a file below a root. An import is whole
or absent: its sequences appear all at once. A fault is the failure of its run: a code (DST-…), and a sentence that
starts with file, row and token.
"""

from typing import Annotated

from fastapi import APIRouter, Path, Request, Response
from sqlalchemy import select
from sqlalchemy.orm import Session

from api import audit
from api.answers import refusals
from api.deps import Caller, Curator, PlatformDep, Reader
from api.errors import NotFoundError
from api.etags import set_head
from api.files import StoredFile, answer_file, file_responses
from api.paging import Page, PageDep, page
from api.schemas.base import IdPath
from api.schemas.dataset_imports import DatasetImportDetail, DatasetImportItem, NewDatasetImportBody
from api.views.imports.class_maps import stated_classes
from api.views.imports.items import import_detail, import_items
from api.visible import theirs
from services.domain.imports.kept_files import TYPE, kept_file
from services.domain.imports.requests import delete_import, place_of, start_import
from services.runtime.orm import DatasetImport, User
from stone_base.errors import splits_forbidden
from stone_datasets.extra_files import LONGEST_NAME
from stone_files.archives import NAME

FilePath = Annotated[str, Path(pattern=f"^{NAME.pattern}$", max_length=LONGEST_NAME, examples=["infos.pkl"])]
router = APIRouter(prefix="/dataset-imports", tags=["dataset imports"])


@router.post(
    "",
    summary="Import a dataset from a complete upload or in place",
    status_code=202,
    responses=refusals(403, 404, 409, 422),
)
def create_dataset_import(
    body: NewDatasetImportBody, caller: Curator, platform: PlatformDep, response: Response
) -> DatasetImportDetail:
    """Import by the job `job_id`. An upload can be used once.

    An archive `in_place` is read where it lies; the job checks that it exists.
    """
    if body.sets_splits and not caller.is_administrator:  # the role is checked below; here, the token's scope
        raise splits_forbidden()
    classes = None if body.classes is None else stated_classes(body.classes)
    with platform.database.transaction() as session:
        owner, roots = session.get_one(User, caller.user_id), platform.settings.in_place
        imported, run = start_import(session, owner, body.wished(classes), roots)
        facts = {"upload_id": body.upload_id, "job_id": run.id, "sets_splits": body.sets_splits}
        if (source := place_of(imported)) is not None:
            facts["place"] = str(source)
        audit.record(session, caller, "dataset_import.create", imported.id, facts=facts)
        shown = import_detail(session, imported)
    return set_head(response, shown, location=f"/api/v1/dataset-imports/{shown.id}")


@router.get("")
def list_dataset_imports(caller: Reader, platform: PlatformDep, query: PageDep) -> Page[DatasetImportItem]:
    """List your imports, newest first; administrators see all imports."""
    mine = theirs(select(DatasetImport), caller, DatasetImport.owner_id)
    with platform.database.reading() as session:
        imports = page(session, mine, DatasetImport.id.desc(), query)
        return Page[DatasetImportItem](items=import_items(session, imports.rows), next=imports.next)


@router.get("/{import_id}", responses=refusals(404))
def show_dataset_import(import_id: IdPath, caller: Reader, platform: PlatformDep) -> DatasetImportDetail:
    """Show an import with its scenes."""
    with platform.database.reading() as session:
        return import_detail(session, import_shown_to(session, caller, import_id))


@router.get(
    "/{import_id}/files/{path:path}",
    summary="Download a kept file of an imported dataset",
    response_class=Response,
    responses=file_responses(TYPE),
)
@router.head(
    "/{import_id}/files/{path:path}",
    summary="Show size and checksum of a kept file",
    response_class=Response,
    responses=file_responses(TYPE),
    name="describe_kept_file",
    description="Show size and checksum of a kept file.",
)
def download_kept_file(
    import_id: IdPath, path: FilePath, caller: Reader, platform: PlatformDep, request: Request
) -> Response:
    """Return one of the import's `kept_files`, unchanged."""
    with platform.database.reading() as session:
        row, blob = kept_file(session, import_shown_to(session, caller, import_id), path)
        file = StoredFile(blob.object_key, row.size_bytes, blob.sha256, row.media_type, path.rpartition("/")[2])
    return answer_file(request, platform.store, file)


@router.delete(
    "/{import_id}",
    summary="Stop a running import, or delete an ended one",
    status_code=204,
    responses=refusals(403, 404),
)
def delete_dataset_import(import_id: IdPath, caller: Curator, platform: PlatformDep) -> None:
    """Stop or delete the import. The tar of an ended import is deleted; its sequences stay."""
    with platform.database.transaction() as session:
        imported = import_shown_to(session, caller, import_id)
        delete_import(session, imported)
        audit.record(session, caller, "dataset_import.delete", import_id, facts={"name": imported.name})


def import_shown_to(session: Session, caller: Caller, import_id: str) -> DatasetImport:
    """Return an import that the caller may view. Raises `NotFoundError`."""
    mine = theirs(select(DatasetImport), caller, DatasetImport.owner_id).where(DatasetImport.id == import_id)
    row = session.scalars(mine).one_or_none()
    if row is None:
        raise NotFoundError("import", import_id)
    return row
