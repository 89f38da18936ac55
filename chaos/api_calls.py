"""API helpers of the drills: upload a recording, start its run, and send half of a file.

**Conventions.** All calls go over HTTP by the client's own functions, so the platform may be of another release, on
another machine, or both.
"""

import base64
import time
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

from chaos.inputs import SEQUENCE, Inputs
from chaos.result_hashes import OwnerRun
from chaos.turns import await_true
from stone_client.api import Api
from stone_client.files.bags import hashed_bag
from stone_client.server.sequences import add_recording, ensure_sequence, pin_calibration, start_run

TUS = {"Tus-Resumable": "1.0.0"}
BYTES = {**TUS, "Content-Type": "application/offset+octet-stream"}
HALF = bytes(range(256)) * 4096
ENDED = ("succeeded", "failed", "cancelled")


@dataclass(frozen=True)
class HalfSent:
    """An upload of twice `HALF` bytes, with the first half sent."""

    address: str


def upload_sequence(api: Api, inputs: Inputs, name: str = SEQUENCE) -> dict[str, Any]:
    """Upload the recording with its calibration, and wait until it is registered."""
    sequence: dict[str, Any] = dict(ensure_sequence(api, name))
    pin_calibration(api, sequence, inputs.calibration)
    add_recording(api, sequence, hashed_bag(inputs.bag, _silent), _silent)
    return sequence


def begin_run(api: Api, sequence: dict[str, Any], inputs: Inputs, **request: str) -> OwnerRun:
    run = start_run(api, sequence, request)
    return OwnerRun(sequence["owner_id"], sequence["id"], run["id"], inputs.sha256, inputs.size_bytes)


def await_jobs(api: Api, run_id: str, jobs: int, within_s: float = 600.0) -> int:
    """Wait until `jobs` jobs of the run ended, or all; return their number. Fresh sources compile kernels first."""
    done: list[int] = []

    def are_done() -> bool:
        run = api.read(f"/jobs/{run_id}")
        done[:] = [run["progress"]["done"]]
        return done[0] >= jobs or run["state"] in ENDED

    await_true(f"{jobs} jobs of run {run_id}", are_done, every_s=0.05, within_s=within_s)
    return done[0]


def await_run(api: Api, run_id: str, within_s: float = 300.0) -> str:
    """Return the state in which the run ended."""
    states: list[str] = []

    def has_ended() -> bool:
        states[:] = [api.read(f"/jobs/{run_id}")["state"]]
        return states[0] in ENDED

    await_true(f"the end of run {run_id}", has_ended, every_s=0.2, within_s=within_s)
    return states[0]


def run_in_place_of(api: Api, brought: OwnerRun) -> str:
    """Return the newest run of the sequence if it is another one; else ""."""
    runs = api.pages("/jobs", kind="sequence.process", sequence_id=brought.sequence_id)
    newest: str = max(run["id"] for run in runs)
    return "" if newest == brought.run_id else newest


def send_half(api: Api) -> HalfSent:
    digest = sha256(HALF * 2).hexdigest()
    fields = {"filename": "half.mcap", "purpose": "recording", "sha256": digest}
    metadata = ",".join(f"{key} {base64.b64encode(value.encode()).decode('ascii')}" for key, value in fields.items())
    headers = {**TUS, "Upload-Length": str(2 * len(HALF)), "Upload-Metadata": metadata}
    address = "/uploads/" + api.send("POST", "/uploads", headers=headers).headers["Location"].rpartition("/")[2]
    api.send("PATCH", address, content=HALF, headers={**BYTES, "Upload-Offset": "0"})
    return HalfSent(address)


def send_rest(api: Api, upload: HalfSent) -> str:
    """Send the missing bytes from the server's offset; return the final state. The server checks the whole hash."""
    offset = int(api.send("HEAD", upload.address, headers=TUS).headers["Upload-Offset"])
    rest = (HALF * 2)[offset:]
    if rest:
        api.send("PATCH", upload.address, content=rest, headers={**BYTES, "Upload-Offset": str(offset)})
    items = {item["id"]: item for item in api.pages("/uploads")}
    return str(items[upload.address.rpartition("/")[2]]["state"])


def offset_of(api: Api, upload: HalfSent) -> int:
    return int(api.send("HEAD", upload.address, headers=TUS).headers["Upload-Offset"])


def seconds_since(begun_s: float) -> str:
    return f"{time.monotonic() - begun_s:.1f} s"


def _silent(stage: str, done: int, total: int) -> None:
    """Ignore progress."""
