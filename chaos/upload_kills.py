"""Kills during an upload: the API that receives the file, or the client that sends it.

**Conventions.** A slow line prolongs the request. The kill happens when a random number of bytes is on the server's
disk, or in the store. It is a hit if the upload is then neither empty nor whole.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from subprocess import DEVNULL

from sqlalchemy import select

from chaos.inputs import SEQUENCE
from chaos.result_hashes import OwnerRun
from chaos.throttle import slow_line
from chaos.turns import PATIENCE_S, OwnerRound, await_end, await_true
from services.runtime.orm import Upload
from services.runtime.store.garbage_collection import UPLOADS
from services.runtime.uploads.files import upload_file
from stone_client.server.sequences import find_sequence

BYTES_PER_S = 24e6


class ClientFailedError(Exception):
    """The repeated command failed."""

    def __init__(self, exit_code: int, output: bytes) -> None:
        super().__init__(
            f"the second `stone sequence upload` ended with {exit_code}: {output.decode(errors='replace')[-2000:]}"
        )


def kill_api(turn: OwnerRound) -> OwnerRun:
    """kill −9 the API during a PATCH; the client resumes automatically."""
    with turn.connected() as direct, _detour(turn) as url, turn.connected(url) as api:
        sequence = turn.announce(direct)
        with ThreadPoolExecutor(1) as client:
            sending = client.submit(turn.send, api, sequence)
            _wait_for_share(turn, sending.done)
            turn.target.kill("api")
            sending.result(PATIENCE_S)
        brought = turn.process(direct, sequence)
        await_end(direct, brought.run_id)
        return brought


def kill_client(turn: OwnerRound) -> OwnerRun:
    """kill −9 `stone sequence upload`, then run the same command again."""
    with turn.connected() as api, _detour(turn) as url:
        first = subprocess.Popen(_command(turn, url), env=_environment(turn), stdout=DEVNULL, stderr=DEVNULL)
        try:
            _wait_for_share(turn, lambda: first.poll() is not None)
        finally:
            first.kill()
            first.wait()
        again = subprocess.run(_command(turn, url), env=_environment(turn), capture_output=True, timeout=PATIENCE_S)
        if again.returncode:
            raise ClientFailedError(again.returncode, again.stderr)
        sequence = find_sequence(api, str(json.loads(again.stdout)["sequence"]))
        brought = turn.process(api, sequence)
        await_end(api, brought.run_id)
        return brought


@contextmanager
def _detour(turn: OwnerRound) -> Iterator[str]:
    """Yield the API's URL by the slow line."""
    settings = turn.target.platform.settings.api
    with slow_line((settings.host, settings.port), BYTES_PER_S) as port:
        yield f"http://{settings.host}:{port}"


def _wait_for_share(turn: OwnerRound, is_over: Callable[[], bool]) -> None:
    """Wait until a random share of the file has arrived, or the upload is over; note the victim."""
    size_bytes = turn.target.inputs.size_bytes
    wanted_bytes = int(turn.chance.uniform(0.02, 0.98) * size_bytes)
    await_true(f"{wanted_bytes} bytes on disk", lambda: is_over() or _bytes_here(turn) >= wanted_bytes, every_s=0.01)
    here_bytes = _bytes_here(turn)
    turn.note(f"at {here_bytes / size_bytes:.0%}", is_hit=not is_over() and 0 < here_bytes < size_bytes)


def _bytes_here(turn: OwnerRound) -> int:
    """Return the bytes of the owner's upload on the server's disk or in the store, verified or not."""
    platform = turn.target.platform
    with platform.database.reading() as session:
        upload_id = session.scalar(select(Upload.id).where(Upload.owner_id == turn.owner.user_id))
    if upload_id is None:
        return 0
    if platform.settings.uploads.backend == "store":
        return sum(stored.size_bytes for stored in platform.store.listed(f"{UPLOADS}{upload_id}/"))
    path = upload_file(platform.settings, upload_id)
    return path.stat().st_size if path.exists() else 0


def _command(turn: OwnerRound, url: str) -> list[str]:
    inputs = turn.target.inputs
    stone = Path(sys.executable).with_name("stone")
    options = ["--calibration", inputs.calibration, "--name", SEQUENCE, "--server", url, "--json"]
    return [str(word) for word in (stone, "sequence", "upload", inputs.bag, *options)]


def _environment(turn: OwnerRound) -> Mapping[str, str]:
    return {**os.environ, "STONE_TOKEN": turn.owner.server.token}
