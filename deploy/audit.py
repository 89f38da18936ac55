"""Check every dependency for known vulnerabilities: `python deploy/audit.py`, from the project's root.

**Conventions.** pip-audit checks requirements.lock, npm checks web/package-lock.json; nothing is installed, and only
names and versions are sent. Exit codes: 0 no advisory, 1 at least one advisory, 75 (EX_TEMPFAIL, sysexits.h) a service
did not answer and the other reports no advisory. Accepted advisories are in deploy/audit-accepted.txt, one per line:
the advisory, a blank, the reason.
"""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

CLEAN, FAULTS, UNASKED = 0, 1, 75
LONGEST_S = 300
LOCK, PAGES = Path("requirements.lock"), Path("web")
ACCEPTED = Path("deploy/audit-accepted.txt")
PIP_AUDIT = ("--requirement", str(LOCK), "--no-deps", "--disable-pip", "--format", "json", "--progress-spinner", "off")


@dataclass(frozen=True)
class AdvisoryAnswer:
    """The answer of one service: `faults` has one line per advisory; `failure` is the reason for a missing answer."""

    name: str
    faults: tuple[str, ...] = ()
    packages: int = 0
    failure: str = ""

    def lines(self) -> list[str]:
        if self.failure:
            return [f"{self.name}: NOT AUDITED: {self.failure}"]
        if not self.faults:
            return [f"{self.name}: {self.packages} packages, no advisory"]
        return [f"{self.name}: {line}" for line in self.faults]


def main() -> int:
    os.environ["PATH"] += f"{os.pathsep}{Path('build/node/bin').absolute()}"  # build-pages.sh installs Node there
    accepted = _accepted()
    verdicts = (_python(accepted), _pages(accepted))
    for verdict in verdicts:
        sys.stdout.write("\n".join(verdict.lines()) + "\n")
    if any(verdict.faults for verdict in verdicts):
        return FAULTS
    return UNASKED if any(verdict.failure for verdict in verdicts) else CLEAN


def _python(accepted: Mapping[str, str]) -> AdvisoryAnswer:
    beside = Path(sys.executable).with_name("pip-audit")
    program = shutil.which("pip-audit") or (str(beside) if beside.exists() else "")
    report = _report_of(program, PIP_AUDIT, Path())
    if isinstance(report, str):
        return AdvisoryAnswer("python", failure=report)
    packages = report.get("dependencies")
    if not isinstance(packages, list) or not packages:
        return AdvisoryAnswer("python", failure="pip-audit reported no package")
    if skipped := [f"{package['name']} ({package['skip_reason']})" for package in packages if "skip_reason" in package]:
        return AdvisoryAnswer("python", failure=f"{len(skipped)} packages were skipped, first {skipped[0]}")
    known = [(package, fault) for package in packages for fault in package.get("vulns", ())]
    faults = [
        f"{package['name']} {package['version']}: {fault['id']}, "
        f"fixed in {', '.join(fault['fix_versions']) or 'no version'}"
        for package, fault in known
        if not {fault["id"], *fault.get("aliases", ())} & set(accepted)
    ]
    return AdvisoryAnswer("python", tuple(faults), len(packages))


def _pages(accepted: Mapping[str, str]) -> AdvisoryAnswer:
    report = _report_of(shutil.which("npm") or "", ("audit", "--json", "--package-lock-only"), PAGES)
    if isinstance(report, str):
        return AdvisoryAnswer("pages", failure=report)
    if "vulnerabilities" not in report:
        return AdvisoryAnswer(
            "pages", failure=str(report.get("message") or report.get("error") or "npm returned no result")[:300]
        )
    faults = [
        f"{name}: {via['title']} ({via['url'].rpartition('/')[2]}, {via['severity']})"
        for name, entry in report["vulnerabilities"].items()
        for via in entry["via"]
        if isinstance(via, dict) and via["url"].rpartition("/")[2] not in accepted
    ]
    return AdvisoryAnswer("pages", tuple(faults), int(report["metadata"]["dependencies"]["total"]))


def _report_of(program: str, arguments: Sequence[str], folder: Path) -> dict[str, Any] | str:
    """Return the program's JSON object, whatever its exit code; otherwise the reason for its absence."""
    if not program:
        return "the audit program is not installed"
    try:
        run = subprocess.run([program, *arguments], cwd=folder, capture_output=True, text=True, timeout=LONGEST_S)
    except subprocess.TimeoutExpired:
        return f"no answer within {LONGEST_S} s"
    try:
        report = json.loads(run.stdout)
    except ValueError:
        return next(reversed(run.stderr.strip().splitlines()), f"it exited with {run.returncode} and no output")[:300]
    return report if isinstance(report, dict) else "its answer is not a JSON object"


def _accepted() -> dict[str, str]:
    """Return the reason by advisory. Raises `ValueError` for a line without a reason."""
    lines = ACCEPTED.read_text("utf-8").splitlines() if ACCEPTED.exists() else []
    pairs = [line.partition(" ") for line in lines if line.strip() and not line.startswith("#")]
    if bare := [advisory for advisory, _, reason in pairs if not reason.strip()]:
        raise ValueError(f"{ACCEPTED}: {bare[0]} is accepted without a reason; add the reason after it")
    return {advisory: reason.strip() for advisory, _, reason in pairs}


if __name__ == "__main__":
    sys.exit(main())
