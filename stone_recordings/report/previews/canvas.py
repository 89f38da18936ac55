"""The square, dark sheet of the previews: it looks the same in a light and in a dark page.

**Conventions.** Figures are made inside `quality.plots.drawing_style`. Text is ours or plain numbers.
"""

from io import BytesIO

from matplotlib.axes import Axes
from matplotlib.figure import Figure

BACKGROUND, INK, SOFT, LINE = "#12150f", "#f2f4ee", "#aab3a2", "#3a4134"
SIDE_IN, DOTS_PER_IN = 6.4, 140
TEXT_POINTS = 11


def square_figure() -> Figure:
    return Figure(figsize=(SIDE_IN, SIDE_IN), facecolor=BACKGROUND, layout="constrained")


def dressed(axes: Axes, labels: tuple[str, str], title: str) -> None:
    """Give axes equal scales, a quiet style, and `labels` of x and y in metres."""
    axes.set_facecolor(BACKGROUND)
    axes.set_aspect("equal", adjustable="box")
    axes.tick_params(colors=SOFT, labelsize=TEXT_POINTS, length=0)
    axes.set_xlabel(labels[0], color=SOFT, fontsize=TEXT_POINTS)
    axes.set_ylabel(labels[1], color=SOFT, fontsize=TEXT_POINTS)
    axes.set_title(title, color=INK, fontsize=TEXT_POINTS + 1, loc="left")
    for spine in axes.spines.values():
        spine.set_visible(False)


def png(figure: Figure) -> bytes:
    """Return the figure as PNG without the program's name, whose version would change the bytes."""
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=DOTS_PER_IN, metadata={"Software": None})
    return stream.getvalue()
