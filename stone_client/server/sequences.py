"""Server operations of several commands: sequences by name, calibrations, recordings, runs.

**Conventions.** Answers are the API's own JSON objects (`/api/v1/openapi.json`). Every request may be repeated:
existing objects are reused.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from stone_base.errors import Refused
from stone_client.api import Api, Patience
from stone_client.errors import ServerRefusedError, unknown_subject
from stone_client.files.bags import LocalBag, part_of
from stone_client.files.parallel import upload_in_parts
from stone_client.files.tus import Purpose
from stone_client.progress import Report
from stone_client.server.ids import is_id, is_short_id, whole_id
from stone_client.server.job_following import AWAY_S, POLL_S, follow
from stone_files.calibration_bundle import read_bundle, zipped

Item = Mapping[str, Any]


def sequence_named(api: Api, name: str) -> Item | None:
    """Return the visible sequence of that name, preferably the caller's own; None if there is none."""
    named = [item for item in api.pages("/sequences", name=name) if item["name"] == name]
    if len(named) > 1:
        own = str(api.read("/me")["user_id"])
        named.sort(key=lambda item: item["owner_id"] != own)
    return named[0] if named else None


def ensure_sequence(api: Api, name: str) -> Item:
    """Return the caller's sequence of that name; create it if it is missing."""
    try:
        return api.create("/sequences", {"name": name})
    except ServerRefusedError as error:
        known = sequence_named(api, name) if error.status == 409 else None
        if known is None:
            raise
        return known


def find_sequence(api: Api, subject: str) -> Item:
    """Return the sequence with that id, name or short id, in full. Raises `not_found`, `ambiguous_id`."""
    return _found(api, subject, ("/sequences",))[1]


def find_job(api: Api, subject: str) -> Item:
    """Return the job with that id, or the newest run of the sequence. Raises `not_found`, `ambiguous_id`."""
    kind, item = find_subject(api, subject)
    if kind == "job":
        return item
    if item["job"] is None:
        raise unknown_subject(subject)
    return api.read(f"/jobs/{item['job']['id']}")


def find_subject(api: Api, subject: str) -> tuple[str, Item]:
    """Return "job" or "sequence", and the object with that id, name or short id. Raises `not_found`, `ambiguous_id`."""
    path, item = _found(api, subject, ("/jobs", "/sequences"))
    return path[1:-1], item


def pin_calibration(api: Api, sequence: Item, calibration: Path) -> Item:
    """Set the sequence's calibration to this file or folder of files; return the calibration with its findings."""
    if calibration.is_dir():
        sent = (f"{calibration.resolve().name}.zip", zipped(read_bundle(calibration)))
    else:
        sent = (calibration.name, calibration.read_bytes())
    kept: Item = api.send("POST", "/calibrations", files={"file": sent}).json()
    api.send("PUT", f"/sequences/{sequence['id']}/calibration", json={"calibration_id": kept["id"]})
    return kept


def add_recording(api: Api, sequence: Item, local: LocalBag, progress: Report) -> Item:
    """Upload the files of the bag and add them as a recording; an existing recording is reused.

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
    """Return whether the sequence has a recording other than this bag."""
    recordings = api.pages(f"/sequences/{sequence['id']}/recordings")
    return any(recording["sha256"] != local.sha256 for recording in recordings)


def recordings_named(api: Api, sequence: Item, subjects: Iterable[str]) -> list[str]:
    """Return the ids of the sequence's recordings with these names or ids. Raises `not_found`."""
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
    """Request processing of the sequence; return the new or existing run."""
    return api.create(f"/sequences/{sequence['id']}/process", body)


def _recorded(api: Api, sequence: Item, local: LocalBag) -> Item | None:
    for recording in api.pages(f"/sequences/{sequence['id']}/recordings"):
        if (recording["sha256"], recording["filename"]) == (local.sha256, local.name):
            read: Item = recording
            return read
    return None


def registered(api: Api, sequence: Item, recording: Item) -> Item:
    """Return the recording after it was read. Raises the code of its first finding."""
    path = f"/sequences/{sequence['id']}/recordings/{recording['id']}"
    read = _until(lambda: api.read(path), lambda item: item["state"] != "received")
    if read["state"] == "refused":
        reason = next(iter(read["findings"]), {"code": "", "message": "it cannot be read"})
        raise Refused(reason["code"] or "recording_refused", f"{read['filename']}: {reason['message']}")
    return read


def _until(read: Callable[[], Item], is_enough: Callable[[Item], bool]) -> Item:
    """Read until `is_enough` is true or the time is up; return the last value."""
    patience = Patience(AWAY_S)
    while True:
        item = read()
        if is_enough(item) or not patience.wait(POLL_S):
            return item


def _found(api: Api, subject: str, paths: Sequence[str]) -> tuple[str, Item]:
    """Return the path and the item: by its whole id, then by a sequence's name, then by a short id.

    Raises `not_found`, `ambiguous_id`.
    """
    for path in paths:
        if item := _by_id(api, path, subject):
            return path, item
    if named := sequence_named(api, subject):
        return "/sequences", api.read(f"/sequences/{named['id']}")
    path_of = {str(entry["id"]): path for path in paths for entry in api.pages(path)} if is_short_id(subject) else {}
    whole = whole_id(subject, path_of)
    if whole is None:
        raise unknown_subject(subject)
    return path_of[whole], api.read(f"{path_of[whole]}/{whole}")


def _by_id(api: Api, path: str, subject: str) -> Item | None:
    if not is_id(subject):
        return None
    try:
        return api.read(f"{path}/{subject}")
    except ServerRefusedError as error:
        if error.status != 404:
            raise
        return None
