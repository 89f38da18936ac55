"""What a child of ingest works with is loaded before it is forked."""

import subprocess
import sys
from pathlib import Path

import pytest

from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate

ROOT = Path(__file__).resolve().parents[3]
ASKED = """
import services.runtime.one_thread
import sys
from pathlib import Path
from services.runtime.processes.worker import FORKED_FROM
from services.runtime.sandbox.fork_server import load_first

load_first(FORKED_FROM["ingest"])
loaded = set(sys.modules)

from services.ingest.sandboxed_inspection import inspected_in
from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sequence import open_sequence
from stone_recordings.bags.bag import open_bag
from stone_recordings.report.overlay import overlays_of
from stone_recordings.report.quality.page import quality_page
from stone_recordings.report.quality.report import quality_of

bag, calibration = map(Path, sys.argv[1:])
with open_bag(bag) as opened:
    inspection = inspected_in(opened)
    quality_page("run", inspection, quality_of(opened, inspection), ())
    sequence, sweeps = open_sequence(bag, calibration, "run", SynchroniseOptions())
    list(overlays_of(opened, sequence, sweeps))
assert sequence.height_drift is not None
for name in sorted(set(sys.modules) - loaded):
    if not name.startswith("encodings."):
        print(name)
"""


@pytest.mark.release
def test_a_child_that_registers_synchronises_or_checks_loads_no_module(tmp_path: Path) -> None:
    """Catches alone a library that every child loads anew, 0.1 s each, because the warm-up forgets it."""
    bag = tmp_path / "run.mcap"
    simulate(bag, SimulateOptions(seconds=3.0, seed=3, channels=32, columns=360, camera_width_px=96))
    command = [sys.executable, "-c", ASKED, str(bag), str(calibration_path(bag))]
    told = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True, timeout=600)
    assert told.stdout.split() == []
