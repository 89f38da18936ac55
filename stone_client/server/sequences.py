"""Server operations of several commands: sequences by name, calibrations, recordings, runs.

**Conventions.** Answers are the API's own JSON objects (`/api/v1/openapi.json`). Everything may be asked again: what is
there already is used, not made twice.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from stone_base.errors import Refused
from stone_client.api import Api, Patience
from stone_client.errors import ServerRefusedError, unknown_subject
from stone_client.files.bags import LocalBag, part_of
from stone_client.files.parallel import upload_in_parts
from stone_client.files.tus import Purpose
from stone_client.progress import Report
from stone_client.server.job_following import AWAY_S, POLL_S, follow
from stone_files.calibration_bundle import read_bundle, zipped

Item = Mapping[str, Any]
ID = re.compile(r"[0-9a-f]{32}")


def sequence_named(api: Api, name: str) -> Item | None:
    """The sequence of that name, rather one's own; None where there is none that the caller may see."""
    named = [item for item in api.pages("/sequences", name=name) if item["name"] == name]
    if len(named) > 1:
        own = str(api.read("/me")["user_id"])
        named.sort(key=lambda item: item["owner_id"] != own)
    return named[0] if named else None


def ensure_sequence(api: Api, name: str) -> Item:
    """One's own sequence of that name, made where there is none."""
    try:
        return api.create("/sequences", {"name": name})
    except ServerRefusedError as error:
        known = sequence_named(api, name) if error.status == 409 else None
        if known is None:
            raise
        return known


def find_sequence(api: Api, subject: str) -> Item:
    """The sequence with that name or id, in full. Raises `not_found`."""
    found = _by_id(api, "/sequences", subject)
    if found is None:
        named = sequence_named(api, subject)
        if named is None:
            raise unknown_subject(subject)
        found = api.read(f"/sequences/{named['id']}")
    return found


def find_job(api: Api, subject: str) -> Item:
    """The job with that id, or the newest run of the sequence so called. Raises `not_found`."""
    job = job_by_id(api, subject)
    if job is None:
        newest = find_sequence(api, subject)["job"]
        if newest is None:
            raise unknown_subject(subject)
        job = api.read(f"/jobs/{newest['id']}")
    return job


def job_by_id(api: Api, subject: str) -> Item | None:
    """The job with that id; None where that is no job of the caller's."""
    return _by_id(api, "/jobs", subject)


def pin_calibration(api: Api, sequence: Item, calibration: Path) -> Item:
    """Have the sequence use this calibration file, or folder of files; the calibration with its findings."""
    if calibration.is_dir():
        sent = (f"{calibration.resolve().name}.zip", zipped(read_bundle(calibration)))
    else:
        sent = (calibration.name, calibration.read_bytes())
    kept: Item = api.send("POST", "/calibrations", files={"file": sent}).json()
    api.send("PUT", f"/sequences/{sequence['id']}/calibration", json={"calibration_id": kept["id"]})
    return kept


def add_recording(api: Api, sequence: Item, local: LocalBag, progress: Report) -> Item:
    """Send the files of the bag and have it read; a bag that the sequence has already is not sent again.

    Raises the code of a refused recording's first finding, `JobFailedError`, and what `upload_in_parts` raises.
    """
    recording = _recorded(api, sequence, local)
    if recording is None:
        purpose = Purpose("recording", sequence["id"])
        upload_ids = []
        for number, file in enumerate(local.files):
            before = sum(earlier.size_bytes for earlier in local.files[:number])
            upload_ids.append(upload_in_parts(api, file, purpose, part_of(progress, before, local.size_bytes)))
        several = {"upload_ids": upload_ids, "name": local.name}
        body = several if len(upload_ids) > 1 else {"upload_id": upload_ids[0]}
        accepted = api.create(f"/sequences/{sequence['id']}/recordings", body)
        follow(api, accepted["job"]["id"], progress)
        recording = accepted["recording"]
    return registered(api, sequence, recording)


def has_other_recording(api: Api, sequence: Item, local: LocalBag) -> bool:
    """Whether the sequence has a recording that is not this bag."""
    recordings = api.pages(f"/sequences/{sequence['id']}/recordings")
    return any(recording["sha256"] != local.sha256 for recording in recordings)


def recordings_named(api: Api, sequence: Item, subjects: Iterable[str]) -> list[str]:
    """The ids of the sequence's recordings with these names or ids. Raises `not_found`."""
    recordings = list(api.pages(f"/sequences/{sequence['id']}/recordings"))
    ids = {recording[key]: str(recording["id"]) for recording in recordings for key in ("filename", "id")}
    for subject in subjects:
        if subject not in ids:
            raise Refused(
                "not_found",
                f"the sequence has no recording {subject!r}; it has "
                f"{', '.join(sorted(recording['filename'] for recording in recordings)) or 'none'}",
            )
    return [ids[subject] for subject in subjects]


def start_run(api: Api, sequence: Item, body: Mapping[str, Any]) -> Item:
    """Have the sequence processed; the run that does it, or has done it."""
    return api.create(f"/sequences/{sequence['id']}/process", body)


def _recorded(api: Api, sequence: Item, local: LocalBag) -> Item | None:
    for recording in api.pages(f"/sequences/{sequence['id']}/recordings"):
        if (recording["sha256"], recording["filename"]) == (local.sha256, local.name):
            found: Item = recording
            return found
    return None


def registered(api: Api, sequence: Item, recording: Item) -> Item:
    """The recording once it has been read. Raises the code of its first finding."""
    path = f"/sequences/{sequence['id']}/recordings/{recording['id']}"
    read = _until(lambda: api.read(path), lambda item: item["state"] != "received")
    if read["state"] == "refused":
        reason = next(iter(read["findings"]), {"code": "", "message": "it cannot be read"})
        raise Refused(reason["code"] or "recording_refused", f"{read['filename']}: {reason['message']}")
    return read


def _until(read: Callable[[], Item], is_enough: Callable[[Item], bool]) -> Item:
    """Read until it is as wished, or until waiting makes no sense any more: then what was read last."""
    patience = Patience(AWAY_S)
    while True:
        item = read()
        if is_enough(item) or not patience.wait(POLL_S):
            return item


def _by_id(api: Api, path: str, subject: str) -> Item | None:
    if not ID.fullmatch(subject):
        return None
    try:
        return api.read(f"{path}/{subject}")
    except ServerRefusedError as error:
        if error.status != 404:
            raise
        return None
