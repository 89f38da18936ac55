"""Benchmarks on a server, for participants: phases by name, their manifests, their inputs."""

from hashlib import sha256
from pathlib import Path
from typing import Any
from urllib.parse import quote

from rich.table import Table

from stone_client.api import Api
from stone_client.progress import Report
from stone_client.server.exports import complete_file
from stone_client.server.sequences import Item
from stone_client.tables import DASH, plain_table, safe_text
from stone_files.atomic import atomic_file


def phase_path(benchmark: str, phase: str) -> str:
    """Return the URL path of a phase."""
    return f"/benchmarks/{quote(benchmark, safe='')}/phases/{quote(phase, safe='')}"


def read_benchmarks(api: Api) -> list[Item]:
    """Return all benchmarks with their phases, newest first."""
    return [read_benchmark(api, str(item["name"])) for item in api.pages("/benchmarks")]


def read_benchmark(api: Api, name: str) -> Item:
    """Return a benchmark with its phases in full."""
    return api.read(f"/benchmarks/{quote(name, safe='')}")


def administered_phase(api: Api, benchmark: str, phase: str) -> str:
    """Return the path of a phase for administrators."""
    return f"/admin/phases/{read_phase(api, benchmark, phase)['id']}"


def read_phase(api: Api, benchmark: str, phase: str) -> Item:
    """Return a phase: its rules, its state and its active ground truth."""
    return api.read(phase_path(benchmark, phase))


def fetch_manifest(api: Api, of: tuple[str, str], output: Path) -> dict[str, Any]:
    """Write the frames that a submission to this phase (benchmark, name) must contain; return a record of them."""
    content = api.send("GET", f"{phase_path(*of)}/manifest").content
    output.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(output) as staging:
        staging.write_bytes(content)
    digest = sha256(content).hexdigest()
    return {"output": str(output), "size_bytes": len(content), "sha256": digest}


def download_inputs(api: Api, of: tuple[str, str], folder: Path, progress: Report) -> list[dict[str, Any]]:
    """Download the missing tars of the sequences of this phase (benchmark, name); return a record of all files.

    Raises `damaged_download`, `download_under_way`, and what `fetch` raises.
    """
    own = f"/phases/{read_phase(api, *of)['id']}/inputs"
    made = []
    for item in list(api.pages(own)):
        wanted = {"size_bytes": item["tar_bytes"], "sha256": item["tar_sha256"]}
        path, output = f"{own}/{quote(item['name'], safe='')}.tar", folder / f"{item['name']}.tar"
        made.append({"name": item["name"], **complete_file(api, path, wanted, output, progress)})
    return made


def phases_table(benchmark: Item) -> Table:
    """Return a table with one row per phase."""
    table = plain_table(safe_text(benchmark["name"]), "phase", "runs", "truth", "frames", "scorings", "closes")
    for phase in benchmark["phases"]:
        active, limit = phase["active"], phase["scorings_per_window"]
        frames = f"{active['frames']:,}" if active else DASH
        allowed = "unlimited" if limit is None else f"{limit} in {phase['window_s'] / 86_400:g} days"
        truth = "hidden" if phase["is_hidden"] else "open"
        closes = (phase["closes_at"] or DASH)[:16]
        table.add_row(safe_text(phase["name"]), phase["standing"], truth, frames, allowed, closes)
    return table
