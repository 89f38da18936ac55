"""The difference a re-score makes, as a Markdown page for the administrator.

**Conventions.** Names and methods are what strangers wrote: whatever Markdown or HTML would read as more than text is
escaped. Ratios with four decimals, moves with their sign, nothing as –.
"""

import re

from services.domain.benchmarks.rescores.diff import RescoreDiff, RescoreMove, RescoreSide
from services.domain.benchmarks.rescores.progress import RescoreProgress

SPECIAL = re.compile(r"([\\`*_{}\[\]()<>#+\-.!|~&$^=:\"'@/])")
HEAD = ("rank", "was", "move", "mIoU", "was", "change", "team", "method", "track", "submission")
NOTHING = "–"


def rescore_page(diff: RescoreDiff, progress: RescoreProgress, reason: str) -> str:
    """The page; one row for each entry and baseline, in the order of the new ranks."""
    old, new = (_version_cell(side) if side else "no board" for side in (diff.old, diff.new))
    table = [_row(HEAD), _row(("---",) * len(HEAD)), *(_row(_cells(moved)) for moved in diff.rows)]
    said = [f"# From {old} to {new}", f"Reason: {plain(reason)}", _progress(progress), _summary(diff)]
    return "\n\n".join([*said, "\n".join(table)]) + "\n"


def plain(text: str) -> str:
    """The text with everything escaped that Markdown would read as more than that."""
    return SPECIAL.sub(r"\\\1", text)


def _version_cell(side: RescoreSide) -> str:
    return f"ground truth {side.truth_number} by {plain(side.metric)}"


def _progress(progress: RescoreProgress) -> str:
    told = [f"{progress.scored} of {progress.total} submissions on the board are scored by the new evaluation version"]
    told += [f"{progress.missing} are still missing"] if progress.missing else []
    told += [f"{progress.hidden} hidden ones are missing"] if progress.hidden else []
    told += [f"the files of {progress.gone} are gone, so they leave the board"] if progress.gone else []
    return "; ".join(told) + "."


def _summary(diff: RescoreDiff) -> str:
    order = "changes" if diff.is_order_changed else "stays as it is"
    leader = "There is a new leader. " if diff.is_new_leader else "The leader stays. "
    largest = f"{diff.largest_rank_move} ranks and {diff.largest_value_move:.4f} of mIoU"
    return f"The order {order}. {leader}Largest moves: {largest}."


def _cells(moved: RescoreMove) -> tuple[str, ...]:
    miou = (side["miou"] if side else None for side in (moved.new, moved.old))
    values = tuple(NOTHING if value is None else f"{value:.4f}" for value in miou)
    ranks = (_whole(moved.new_rank), _whole(moved.old_rank), _signed(moved.rank_move, "d"))
    names = (plain(moved.team), plain(moved.method), moved.modality if moved.kind == "entry" else moved.kind)
    return (*ranks, *values, _signed(moved.value_move, ".4f"), *names, moved.submission_id)


def _whole(rank: int | None) -> str:
    return NOTHING if rank is None else str(rank)


def _signed(move: float | None, form: str) -> str:
    return NOTHING if move is None else f"{move:+{form}}" if move else "0"


def _row(cells: tuple[str, ...]) -> str:
    return f"| {' | '.join(cells)} |"
