"""A whole season on the embedded platform: `python -m benchmarks.season [--teams 30] [--submissions 600]`.

The platform is started like `stone serve` and used over HTTP only. 30 teams send 600 submissions of varied quality,
some of them broken, within a quota that the administrator raises. Three times everything is scored again (with repaired
labels, another metric, and labels repaired once more) while submissions continue, and the board is switched. At the end
`recompute_board.py`, which imports nothing of the platform, computes both boards from the stored confusions. Every
board shown before a switch must still equal its `as_of` board.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks.season.figures import Figures, figures_of, show
from benchmarks.season.people import Season, SeasonTeam, close_all, open_season, signed_in
from benchmarks.season.plan import Play, plan_of
from benchmarks.season.world import VERSIONS, Predictions, SeasonSize, build_season_world
from services.runtime.database.migrate import upgrade
from services.runtime.database.transactions import Database
from services.runtime.embedded.supervisor import running_platform
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings, Settings
from services.runtime.store.factory import open_store
from stone.scoring.metric import OCCUPIED_VERSION

CLIENTS = 4
POLL_S = 0.3
PATIENCE_S = 900.0
RECOMPUTE = Path(__file__).parent / "recompute_board.py"
NO_LIMITS = ApiSettings(port=0, requests_per_minute=10**7, sign_ins_per_minute=10**7)


@dataclass
class SeasonProgress:
    """A running season: its players, and its observations."""

    season: Season
    teams: Sequence[SeasonTeam]
    predictions: Predictions
    folder: Path
    sent: dict[str, Play] = field(default_factory=dict)
    grants: int = 0
    boards: list[tuple[str, Any]] = field(default_factory=list)
    moves: list[dict[str, Any]] = field(default_factory=list)

    def play(self, plays: Sequence[Play]) -> None:
        """Submit these, several at a time, without waiting for results."""
        with ThreadPoolExecutor(CLIENTS) as pool:
            list(pool.map(self._submit, plays))

    def settle(self) -> None:
        """Wait until everything is settled; then withdraw and hide the planned submissions."""
        wait_until(lambda: not set(self.season.states().values()) & {"queued", "scoring"})
        states = self.season.states()
        for submission_id, play in self.sent.items():
            if states[submission_id] == "scored" and (play.is_withdrawn or play.is_hidden):
                self._take_off(submission_id, play)
        self.sent.clear()

    def rescore(self, change: dict[str, str], meanwhile: Sequence[Play]) -> None:
        """Score all with another evaluation version during submissions, read the changes, switch the board."""
        base = f"/admin/phases/{self.season.phase_id}/rescores"
        address = f"{base}/{self.season.admin.create(base, {**change, 'reason': 'labels mended'})['id']}"
        self.play(meanwhile)
        self.settle()
        wait_until(lambda: self.season.admin.read(address)["state"] == "complete")
        answer = self.season.admin.send("GET", f"{address}/diff")
        page = self.season.admin.send("GET", f"{address}/diff", params={"format": "md"}).text
        (self.folder / f"diff-{len(self.moves)}.md").write_text(page)
        self.moves.append(answer.json())
        self.boards.append((datetime.now(UTC).isoformat(), self.season.board("all")))
        match = {"If-Match": answer.headers["ETag"]}
        self.season.admin.send("POST", f"{address}/activate", json={"reason": "as announced"}, headers=match)

    def new_truth(self, dataset: str) -> str:
        """Return the id of a further ground truth, once it is ready."""
        body = {"dataset": dataset, "reason": "labels mended"}
        base = f"/admin/phases/{self.season.phase_id}/ground-truths"
        truth_id = str(self.season.admin.create(base, body)["ground_truth"]["id"])
        self.wait_for_truths()
        return truth_id

    def wait_for_truths(self) -> None:
        base = f"/admin/phases/{self.season.phase_id}/ground-truths"
        wait_until(lambda: all(truth["state"] == "ready" for truth in self.season.admin.pages(base)))

    def recompute(self) -> str:
        """Compare both served boards with the independent script; return its output. Raises `CalledProcessError`."""
        boards: dict[str, Any] = {name: self.season.board(name) for name in ("all", "best")}
        (self.folder / "boards.json").write_text(json.dumps(boards))
        for row in boards["all"]["rows"]:
            if row["standing"] == "ranked":
                address = f"/submissions/{row['submission_id']}/confusions"
                kept = self.season.admin.send("GET", address).content
                (self.folder / f"{row['submission_id']}.npz").write_bytes(kept)
        command = [sys.executable, str(RECOMPUTE), str(self.folder)]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    def ties(self) -> str:
        """Return the tie groups of the last board, or the reason for their absence."""
        board: Any = self.season.board("all")
        groups = [row["tie_group"] for row in board["rows"] if row["standing"] == "ranked"]
        if not any(groups):
            return str(board["notes"][0])
        return f"{len(set(groups))} groups of {len(groups)} entries, the largest of {max(map(groups.count, groups))}"

    def changed_past(self) -> int:
        """Return how many of the boards before the switches differ from their `as_of` boards."""
        return sum(
            self.season.board("all", as_of=moment)[part] != shown[part]
            for moment, shown in self.boards
            for part in ("rows", "pair")
        )

    def _submit(self, play: Play) -> None:
        team = self.teams[play.team]
        api = team.captain if play.is_captain else team.member
        zipped = self.predictions.pack(self.folder / f"{play.number}.zip", play.levels, play.spoil)
        sent = self.season.submit((team, api), zipped, f"net {play.number}")
        zipped.unlink()
        self.sent[sent.id] = play
        self.grants += sent.granted

    def _take_off(self, submission_id: str, play: Play) -> None:
        if play.is_withdrawn:
            self.teams[play.team].captain.send("POST", f"/submissions/{submission_id}/withdraw", json={})
            return
        body = {"hidden": True, "reason": "under review"}
        self.season.admin.send("PUT", f"/admin/submissions/{submission_id}/visibility", json=body)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--teams", type=int, default=30)
    parser.add_argument("--submissions", type=int, default=600)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    size = SeasonSize(teams=options.teams, submissions=options.submissions)
    with tempfile.TemporaryDirectory() as folder:
        show(run_season(Path(folder), size, options.workers))


def run_season(folder: Path, size: SeasonSize, workers: int = 2) -> Figures:
    """Run the season on a fresh platform below `folder`; fails if a board is wrong."""
    settings = Settings(data_folder=folder / "data", workers=workers, api=NO_LIMITS)
    upgrade(settings)
    with closing(Database(settings)) as database:
        predictions = build_season_world(Platform(settings, database, open_store(settings)), size)
    with running_platform(settings) as running:
        admin = signed_in(running.url, running.keys.name, running.keys.password)
        season = open_season(admin, VERSIONS[0], size.scorings)
        course = SeasonProgress(
            season, [season.found_team(number) for number in range(size.teams)], predictions, folder
        )
        course.wait_for_truths()
        begun_s = time.perf_counter()
        play_season(course, plan_of(size))
        lasted_s = time.perf_counter() - begun_s
        recomputed, changed, ties = course.recompute(), course.changed_past(), course.ties()
        figures = figures_of(running.platform, season, lasted_s)
        close_all(season, course.teams)
    return replace(
        figures, grants=course.grants, moves=course.moves, recomputed=recomputed, changed_past=changed, ties=ties
    )


def play_season(course: SeasonProgress, plan: Sequence[Play]) -> None:
    """Play four quarters; after each of the first three everything is scored again during the next one."""
    quarter = -(-len(plan) // 4)
    first, *rest = (plan[at : at + quarter] for at in range(0, len(plan), quarter))
    course.play(first)
    course.settle()
    for (what, value), meanwhile in zip(
        (("truth_id", VERSIONS[1]), ("metric", OCCUPIED_VERSION), ("truth_id", VERSIONS[2])), rest, strict=True
    ):
        course.rescore({what: course.new_truth(value) if what == "truth_id" else value}, meanwhile)


def wait_until(claim: Any) -> None:
    """Wait until the claim is true. Raises `TimeoutError`."""
    end_s = time.monotonic() + PATIENCE_S
    while not claim():
        if time.monotonic() > end_s:
            raise TimeoutError("the season stands still")
        time.sleep(POLL_S)


if __name__ == "__main__":
    main()
