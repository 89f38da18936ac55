"""How labels made from a part of the way hold on the rest of it, for parts of several lengths."""

from benchmarks.real.labelled_map import Figures
from services.labeler.map.held_out import HeldOutTrack
from services.labeler.results import load_summaries
from services.labeler.run import LabelRun

KNOWN_RATIOS = (0.35, 0.5, 0.7)


def held_out_figures(run: LabelRun) -> Figures:
    """The recall of labels from the first and from the last part of the way, None where too little ground was driven;
    the stages of the run are done and in its scratch."""
    track, figures = HeldOutTrack(run, load_summaries(run)), Figures()
    for ratio in KNOWN_RATIOS:
        for side, found in (("first", track.from_first(ratio)), ("last", track.from_last(ratio))):
            figures[f"{side}_{ratio:g}"] = None if found is None else found.recall
    return figures
