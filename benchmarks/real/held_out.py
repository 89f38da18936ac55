"""Agreement of labels from a part of the track with the rest, for parts of several lengths."""

from benchmarks.real.labelled_map import Figures
from services.labeler.map.held_out import HeldOutTrack
from services.labeler.results import load_summaries
from services.labeler.run import LabelRun

KNOWN_RATIOS = (0.35, 0.5, 0.7)


def held_out_figures(run: LabelRun) -> Figures:
    """Return the recall of labels from the first and from the last part of the track, None with too little driven
    ground.

    The stages of the run are complete and in its scratch.
    """
    track, figures = HeldOutTrack(run, load_summaries(run)), Figures()
    for ratio in KNOWN_RATIOS:
        for side, part in (("first", track.from_first(ratio)), ("last", track.from_last(ratio))):
            figures[f"{side}_{ratio:g}"] = None if part is None else part.recall
    return figures
