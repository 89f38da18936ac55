"""The outcomes of `benchmarks.faults` as a Markdown table: a row per fault, the two drives beside each other."""

from collections.abc import Mapping
from typing import Any

# by drive, by fault ("" is none): records of `FaultOutcome.as_record`
Outcomes = dict[str, dict[str, dict[str, Any]]]


def shown(made: Outcomes, before: Outcomes) -> str:
    """Return the table of each drive, one after the other."""
    return "\n\n".join(_of_drive(drive, rows, before.get(drive, {})) for drive, rows in made.items())


def goes_through(row: Mapping[str, Any]) -> bool:
    """Return whether the fault went undetected.

    This is a crash, T outside the driven ground, a refusal or an exclusion that inspection did not report, or an
    inspection error without a refusal.
    """
    if row["refusal"]:
        return row["refusal"] not in row["errors"]
    return bool(row["errors"]) or bool(row["beyond"]) or (bool(row["excluded"]) and "SYN-501" not in row["named"])


def _of_drive(drive: str, rows: Mapping[str, Mapping[str, Any]], before: Mapping[str, Mapping[str, Any]]) -> str:
    heads = ["fault", "`inspect` names", "`label`", "T beyond", "P", "as sound"]
    heads[2:2] = ["`label` before"] if before else []
    lines = [f"### {drive}", "", _line(heads), _line(["---"] * len(heads))]
    for fault, row in rows.items():
        cells = [fault or "none", ", ".join(row["named"]), _done(row), *_figures(row)]
        if before:
            cells[2:2] = [_brief(before[fault]) if fault in before else ""]
        lines.append(_line(cells))
    return "\n".join(lines)


def _done(row: Mapping[str, Any]) -> str:
    if row["refusal"]:
        return f"refused: {row['refusal']}"
    excluded = ", ".join(f"{count} {code}" for code, count in row["excluded"].items())
    return f"{row['frames']} frames" + (f", excluded {excluded}" if excluded else "")


def _brief(row: Mapping[str, Any]) -> str:
    """Return an earlier run's row in one cell."""
    if row["refusal"]:
        return _done(row)
    beyond = f", T beyond {row['beyond']}" if row["beyond"] else ""
    return f"{_done(row)}{beyond}, P {row['p_share']:.1%}"


def _figures(row: Mapping[str, Any]) -> list[str]:
    if row["refusal"]:
        return ["", "", ""]
    return [str(row["beyond"]), f"{row['p_share']:.1%}", f"{row['agreement']:.1%}"]


def _line(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"
