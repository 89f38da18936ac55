"""How fast a run is and how long it will take yet, from the steps of the last minutes."""

from collections import deque
from dataclasses import replace
from time import monotonic

from baselines.run_log import TrainingReport

STEPS_REMEMBERED = 200


class RunClock:
    """Stamps reports; the first step of a process, which is slower than others, is not counted."""

    def __init__(self, steps: int, begin: int) -> None:
        self._steps, self._begin = steps, begin
        self._times = deque[tuple[int, float]](maxlen=STEPS_REMEMBERED)

    def stamped(self, report: TrainingReport, frames_a_step: int) -> TrainingReport:
        """The report with rate and time left; both 0 until they are known."""
        self._times.append((report.step, monotonic()))
        (first, begun), (last, now) = self._times[0], self._times[-1]
        if last == first or now <= begun:
            return report
        seconds_a_step = (now - begun) / (last - first)
        left_s = (self._steps - report.step) * seconds_a_step
        return replace(report, frames_per_s=frames_a_step / seconds_a_step, left_s=left_s)
