"""The jitter of a topic is one number: in findings of inspection and synchronisation, the clock record and its tables.

A host that publishes a receiver's messages evenly 1 to 5 ms late has a robust σ of about 1.5 ms, a deviation of
1.2 ms, and no jitter at all against record time: three numbers where each page has an estimator of its own.
"""

from io import StringIO
from pathlib import Path

from rich.console import Console

from stone_client.tables import clock_table
from stone_recordings.bags.bag import open_bag
from stone_recordings.poses.ins_poses import track_from_ins
from stone_recordings.report.quality.section_clocks import clocks_section
from tests.stone_recordings import rigs
from tests.stone_recordings.clocks.streams import MS, clouds, every, inspected, sentence

TIMES_NS = every(50 * MS, 200)
ALIGNING = 80
"""So many of the messages come before the receiver's solution is aligned: their stamps count, their poses do not."""


def test_the_same_jitter_is_said_wherever_it_is_said(tmp_path: Path) -> None:
    lidar = clouds(every(100 * MS, 30), every(100 * MS, 30) + 105 * MS)
    aligning = rigs.ins_messages(TIMES_NS[:ALIGNING], seed=1, ins_status=1)
    inspection = inspected(tmp_path, lidar, aligning, rigs.ins_messages(TIMES_NS[ALIGNING:], seed=2))
    clock = next(clock for clock in inspection.clocks.topics if clock.topic == rigs.INS_TOPIC)
    assert (clock.own_jitter_ns, clock.stated_against) == (clock.stated_jitter_ns, "sensor time")
    shown = f"{(clock.stated_jitter_ns or 0) / 1e6:.2f}"
    assert 1.0 < float(shown) < 2.0
    found = sentence(inspection, "TIM-201", rigs.INS_TOPIC)
    assert f"jitter {shown} ms" in found
    assert _said_by_synchronisation(tmp_path / "run.mcap") == found
    section = clocks_section(inspection.clocks)
    assert section is not None
    assert section.table is not None
    assert shown in str(section.table.rows)
    console = Console(width=140, file=StringIO())
    with console.capture() as table:
        console.print(clock_table(inspection.clocks.as_record()))
    row = next(line for line in table.get().splitlines() if rigs.INS_TOPIC in line)
    assert shown in row.split()


def _said_by_synchronisation(path: Path) -> str:
    with open_bag(path) as bag:
        track = track_from_ins(bag.messages(rigs.INS_TOPIC), rigs.INS_TOPIC, rigs.calibration(), None)
    return next(one.message for one in track.findings if one.code == "TIM-201")
