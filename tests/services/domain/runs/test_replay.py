"""How well recorded runs of the demo were told: the trace is `python -m benchmarks.time_left --save`."""

import json
from pathlib import Path
from statistics import median

from benchmarks.time_left import LIMIT, read_traces, thinned

TRACE = Path(__file__).with_name("demo-trace.json")


def test_recorded_runs_of_the_demo_were_told_within_a_quarter_at_half_time() -> None:
    """Catches alone constants that were tuned for another machine or another demo."""
    errors = [trace.error(0.5) for trace in read_traces(TRACE)]
    assert median(errors) <= LIMIT, errors


def test_what_is_kept_of_traces_is_read_as_it_was() -> None:
    kept = json.dumps([thinned(trace) for trace in read_traces(TRACE)])
    assert json.loads(kept) == json.loads(TRACE.read_text("utf-8"))
