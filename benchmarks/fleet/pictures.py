"""The report's pictures: pace and what bends it, and how long jobs wait."""

from collections.abc import Sequence
from pathlib import Path

from benchmarks.fleet.growing import Step
from benchmarks.fleet.predicting import Forecast

INK, SOFT, WARM = "#1b4965", "#62b6cb", "#c1121f"


def draw_growth(steps: Sequence[Step], path: Path) -> None:
    """Sequences an hour over workers beside what twice as many would do, and the shares of database and store."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    pace, shares = figure.subplots(1, 2)
    workers = [one.workers for one in steps]
    ideal = [steps[0].sequences_per_h * count / workers[0] for count in workers]
    pace.loglog(workers, ideal, "--", color=SOFT, label="every worker as the first")
    pace.loglog(workers, [one.sequences_per_h for one in steps], "o-", color=INK, label="simulated")
    pace.set(xlabel="workers", ylabel="sequences an hour")
    pace.legend(frameon=False)
    for name, values, colour in (
        ("workers busy with work", [one.efficiency for one in steps], INK),
        ("database", [one.database_ratio for one in steps], WARM),
        ("line to the store", [one.line_ratio for one in steps], SOFT),
    ):
        shares.semilogx(workers, values, "o-", color=colour, label=name)
    shares.set(xlabel="workers", ylabel="share of what is to be had", ylim=(0, 1.1))
    shares.legend(frameon=False)
    _save(figure, path)


def draw_forecasts(base_s: float, forecasts: Sequence[Forecast], path: Path) -> None:
    """Measured beside foretold, by workers."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.0, 3.2), layout="constrained")
    axes = figure.subplots()
    places = range(len(forecasts) + 1)
    axes.bar([place - 0.2 for place in places], [base_s, *(one.measured_s for one in forecasts)], 0.38, color=INK,
             label="measured")  # fmt: skip
    axes.bar([place + 0.2 for place in places], [base_s, *(one.predicted_s for one in forecasts)], 0.38, color=SOFT,
             label="foretold by one worker's run")  # fmt: skip
    axes.set_xticks(list(places), [f"{count}" for count in (1, *(one.workers for one in forecasts))])
    axes.set(xlabel="workers", ylabel="seconds")
    axes.legend(frameon=False)
    _save(figure, path)


def _save(figure: object, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)  # type: ignore[attr-defined]
