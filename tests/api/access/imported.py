"""An import of a dataset that somebody owns, and an upload of theirs that another one could be made of."""

from services.domain.imports.kept_files import keep_file
from services.domain.imports.requests import NewImport, start_import
from services.runtime.orm import User, new_id
from services.runtime.platform import Platform
from services.runtime.store import blobs
from testing.api.serving import Person
from testing.worlds import made


def imported(platform: Platform, owner: Person) -> dict[str, str]:
    """`import_id` and `dataset_upload`; the import keeps a file that no table names."""
    sent, waiting = _tar(platform, owner), _tar(platform, owner)
    path = platform.settings.root / f"kept-{new_id()}"
    path.write_bytes(b"kept")
    with platform.database.transaction() as session:
        row, _run = start_import(session, session.get_one(User, owner.user_id), NewImport(sent, "offroad"))
        keep_file(session, row, "mesh.ply", blobs.keep(session, platform.store, path))
        return {"import_id": row.id, "dataset_upload": waiting}


def _tar(platform: Platform, owner: Person) -> str:
    return made.upload(platform, owner, new_id().encode(), purpose="dataset", filename="offroad.tar")
