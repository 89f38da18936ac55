"""Several recordings of one sequence over REST: which are meant, offsets that are known, labels that are older."""

from typing import Any

import httpx
import pytest

from services.domain.sequences.later_recordings import follow_recordings
from services.domain.sequences.processing import PROCESS
from services.runtime.jobs.control import cancel
from services.runtime.orm import CalibrationRow, Job, LabelSet, SequenceRow, Upload
from services.runtime.platform import Platform
from services.runtime.store.blobs import keep
from testing.api.serving import Person
from testing.worlds.made import sequence, upload
from testing.worlds.rows import recording_of

URL = "/api/v1/sequences"


@pytest.fixture
def forest(api: httpx.Client, platform: Platform, curator: Person) -> dict[str, Any]:
    """A sequence with a calibration and two registered recordings."""
    made = sequence(api, curator)
    rig = platform.settings.root / "rig.yaml"
    rig.write_text("stone_calibration: 1\n")
    with platform.database.transaction() as session:
        blob = keep(session, platform.store, rig)
        row = CalibrationRow(
            owner_id=curator.user_id, name="rig", version=1, filename="rig.yaml", sensors=[], findings=[]
        )
        row.sha256 = row.blob_sha256 = blob.sha256
        session.add(row)
        session.flush()
        session.get_one(SequenceRow, made["id"]).calibration_id = row.id
    ids = [registered(platform, curator, made["id"], name) for name in ("lidar.mcap", "cameras.mcap")]
    return {**made, "recording_ids": ids}


def registered(platform: Platform, owner: Person, sequence_id: str, name: str) -> str:
    upload_id = upload(platform, owner, name.encode(), filename=name, state="consumed")
    with platform.database.transaction() as session:
        row = recording_of(session.get_one(Upload, upload_id), sequence_id, "registered")
        row.sha256 = name.encode().hex().ljust(64, "0")
        session.add(row)
        session.flush()
        return row.id


def asked(api: httpx.Client, owner: Person, sequence_id: str, **body: Any) -> httpx.Response:
    return api.post(f"{URL}/{sequence_id}/process", json=body, headers=owner.headers)


@pytest.mark.parametrize(
    "body",
    [
        {"clock_offsets_s": {"cameras.mcap": 1e12}},
        {"clock_offsets_s": {"cameras.mcap": "soon"}},
        {"clock_offsets_s": {"": 0.1}},
        {"clock_offsets_s": {f"{number}.mcap": 0.1 for number in range(65)}},
        {"recording_ids": ["cameras.mcap"]},
        {"recording_ids": ["ab" * 16] * 65},
    ],
)
def test_what_can_be_no_offset_and_no_recording_is_refused(
    api: httpx.Client, curator: Person, forest: dict[str, Any], body: dict[str, Any]
) -> None:
    assert asked(api, curator, forest["id"], **body).status_code == 422


def test_what_is_none_of_the_sequences_is_refused_by_its_code(
    api: httpx.Client, platform: Platform, curator: Person, forest: dict[str, Any]
) -> None:
    unknown = asked(api, curator, forest["id"], recording_ids=["ab" * 16])
    assert (unknown.status_code, unknown.json()["code"]) == (409, "unknown_recording")
    shifted = asked(api, curator, forest["id"], clock_offsets_s={"radar.bag": 0.1})
    assert (shifted.status_code, shifted.json()["code"]) == (422, "bad_clock_offset")
    registered(platform, curator, forest["id"], "LIDAR.mcap")
    alike = asked(api, curator, forest["id"])
    assert (alike.status_code, alike.json()["code"]) == (409, "recordings_named_alike")


def test_offsets_are_given_in_seconds_and_kept_in_nanoseconds(
    api: httpx.Client, platform: Platform, curator: Person, forest: dict[str, Any]
) -> None:
    cameras = forest["recording_ids"][1]
    answer = asked(api, curator, forest["id"], clock_offsets_s={cameras: -0.080000001})
    assert answer.status_code == 202
    with platform.database.reading() as session:
        arguments = session.get_one(Job, answer.json()["id"]).arguments
    assert arguments["clock_offsets_ns"] == {"cameras.mcap": -80_000_001}
    assert arguments["recording_ids"] == forest["recording_ids"]


def test_the_owner_is_told_that_labels_are_older_than_recordings_until_they_are_made_again(
    api: httpx.Client, platform: Platform, curator: Person, participant: Person, forest: dict[str, Any]
) -> None:
    def told(who: Person) -> Any:
        return api.get(f"{URL}/{forest['id']}", headers=who.headers).json()["later_recordings"]

    def labelled(job_id: str) -> None:
        with platform.database.transaction() as session:
            run = cancel(session, job_id, "")
            run.state = "succeeded"
            row = LabelSet(sequence_id=forest["id"], job_id=job_id, recipe=run.arguments["recipe"], parameters={})
            row.code_version, row.frames = "0", 1
            session.add(row)

    labelled(asked(api, curator, forest["id"]).json()["id"])
    assert told(curator) is None
    registered(platform, curator, forest["id"], "radar.bag")
    with platform.database.transaction() as session:
        session.get_one(SequenceRow, forest["id"]).is_public = True
    assert told(curator) == {"names": ["radar.bag"], "why_not": ""}
    assert told(participant) is None
    assert follow_recordings(platform) == 1
    shown = api.get(f"{URL}/{forest['id']}", headers=curator.headers).json()
    assert (shown["job"]["kind"], shown["job"]["state"]) == (PROCESS, "queued")
    assert told(curator) == {"names": ["radar.bag"], "why_not": ""}
    labelled(shown["job"]["id"])
    assert told(curator) is None
