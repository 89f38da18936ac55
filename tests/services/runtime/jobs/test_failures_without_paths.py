"""No failure, job log line or API response contains a path of the server; files appear under their owner's names."""

import json
import tempfile
from pathlib import Path

import pytest
from sqlalchemy import select

from api import problems
from services.runtime.jobs.specs import Attempt, Outcome
from services.runtime.orm import JobLine, Upload
from services.runtime.platform import Platform
from services.runtime.store.keys import StoreFullError
from services.runtime.store.own_names import without_paths
from stone_files.archives import bad_tar
from tests.services.runtime.jobs.steps import a_job, an_owner, job, run_all

SHA256 = "08" * 32


def an_upload(platform: Platform, owner: str, name: str) -> str:
    with platform.database.transaction() as session:
        facts = {"purpose": "dataset", "length_bytes": 7, "state": "consumed", "sha256": SHA256, "declared_sha256": ""}
        upload = Upload(owner_id=owner, filename=name, target_id="", backend="folder", detail="", **facts)
        upload.created_ns = upload.expires_ns = 1
        session.add(upload)
        session.flush()
        return upload.id


@pytest.mark.parametrize(
    "place", ["store/blobs/08/{sha256}.0123abcd", "cache/objects/blobs/08/{sha256}.0123abcd", "uploads/{id}"]
)
def test_a_failure_calls_a_file_as_its_owner_does(platform: Platform, place: str) -> None:
    owner = an_owner(platform)
    upload_id = an_upload(platform, owner, "campus.tar")
    path = platform.settings.root / place.format(sha256=SHA256, id=upload_id)

    def fail(_attempt: Attempt) -> Outcome:
        raise bad_tar(path, "it ends inside the header at byte 5")

    job_id = a_job(platform, owner, "ingest.dataset")
    run_all(platform, {"ingest.dataset": fail})
    failed = job(platform, job_id)
    assert failed.failure.startswith("campus.tar cannot be read as a tar: it ends")
    assert (failed.failure_code, lines_with(platform, str(platform.settings.root))) == ("bad_tar", [])


def test_the_file_of_another_owner_keeps_its_name_to_itself(platform: Platform) -> None:
    an_upload(platform, an_owner(platform, "bob"), "secret name.tar")
    path = platform.settings.root / f"store/blobs/08/{SHA256}.0123abcd"

    def fail(_attempt: Attempt) -> Outcome:
        raise OSError(5, "Input/output error", str(path))

    job_id = a_job(platform, an_owner(platform), "labeler.export")
    run_all(platform, {"labeler.export": fail})
    failed = job(platform, job_id)
    assert failed.failure == "OSError: [Errno 5] Input/output error: 'a stored file'"
    assert lines_with(platform, str(platform.settings.root)) == []


def lines_with(platform: Platform, text: str) -> list[str]:
    with platform.database.reading() as session:
        lines = session.scalars(select(JobLine)).all()
    return [line.event for line in lines if text in line.event or text in json.dumps(line.facts)]


def test_an_answer_of_the_api_names_no_path(platform: Platform) -> None:
    answer = problems.answer_to(StoreFullError(platform.settings.root / "store"))
    assert answer.status_code == 507
    assert json.loads(bytes(answer.body))["detail"].startswith("no space left at store; free space")


def test_temporary_files_and_the_data_folder_itself_are_hidden_and_names_of_topics_are_not(platform: Platform) -> None:
    temporary, root = Path(tempfile.gettempdir()), platform.settings.root
    assert without_paths(f"'{temporary}/stone-x1/run.mcap' is cut") == "'run.mcap' is cut"
    assert without_paths(f"{root} is full; see /tf_static and GET /api/v1/uploads") == (
        "the data folder is full; see /tf_static and GET /api/v1/uploads"
    )
