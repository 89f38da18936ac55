"""The mixed-integer programme of a proposal: rules as soft constraints, similarity of the parts as the objective.

**Conventions.** Columns are numbered in order of creation; a row is its coefficients by column and its bounds. Entries
have a fixed order, so equal catalogues give equal programmes.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, OptimizeResult, milp
from scipy.sparse import csr_array

from stone.splits.composition import CatalogueEntry, sums_of
from stone.splits.splits import (
    DRIVES,
    LENGTH,
    LIGHT,
    PARTS,
    REGIONS,
    SEPARATED_PLACES,
    SIZES,
    WHOLE,
    conditions_of,
    drives_in,
    is_long_enough,
    twins_of,
)

# The cost of violating a rule, per unit. Units are a sequence more or fewer than requested, a sequence too
# short or duplicated, a region in both train and test, and a missing condition. Sizes were requested by the user, so
# they are violated last.
COSTS: Mapping[str, int] = {SIZES: 1000, LENGTH: 300, WHOLE: 300, REGIONS: 100, LIGHT: 10, SEPARATED_PLACES: 10}
TRAIN, TEST = PARTS.index("train"), PARTS.index("test")


@dataclass(frozen=True)
class SolverLimits:
    """Branch-and-bound nodes for proving which rules are feasible, and for similarity (up to a relative gap).

    `time_s` of one solve is only a safety net: a proposal that reaches it depends on the machine.
    """

    rule_nodes: int = 5000
    likeness_nodes: int = 100
    gap_ratio: float = 0.05
    time_s: float = 20.0


@dataclass(frozen=True)
class SplitTask:
    """The sequences to divide, and the requested parts."""

    entries: tuple[CatalogueEntry, ...]
    sizes: tuple[int, int, int]


@dataclass(frozen=True)
class Rule:
    """A rule that may be dropped: its code, and for a condition its word and the matching sequences."""

    code: str
    word: str = ""
    entries: tuple[CatalogueEntry, ...] = ()


def rules_of(sought: SplitTask) -> tuple[Rule, ...]:
    """Return the rules that these data allow, in the order in which they are dropped from a conflict."""
    parts = tuple(part for part, size in zip(PARTS, sought.sizes, strict=True) if size)
    conditions = [c for c in conditions_of(sought.entries) if not c.obstacle(parts)]
    whole = [Rule(code) for code in (WHOLE, DRIVES, LENGTH)]
    return (*whole, *(Rule(c.rule, c.word, c.entries) for c in conditions), Rule(REGIONS), Rule(SIZES))


@dataclass(frozen=True)
class SplitSolution:
    """The part of each entry (−1: none), the violated rules and their cost, and whether the solution is proven
    optimal.
    """

    parts: tuple[int, ...]
    cost: int
    is_proven: bool


@dataclass
class Programme:
    """Columns and rows under construction; `bends` is the cost of each column that violates a rule."""

    upper: list[float] = field(default_factory=list)
    whole: list[int] = field(default_factory=list)
    rows: list[tuple[Mapping[int, float], float, float]] = field(default_factory=list)
    bends: dict[int, float] = field(default_factory=dict)
    objective: dict[int, float] = field(default_factory=dict)

    def column(self, upper: float, *, is_whole: bool = True) -> int:
        """Add a column from 0 to `upper`."""
        self.upper.append(upper)
        self.whole.append(1 if is_whole else 0)
        return len(self.upper) - 1

    def row(self, coefficients: Mapping[int, float], low: float, high: float) -> None:
        self.rows.append((coefficients, low, high))

    def bend(self, code: str, upper: float, *, is_rigid: bool) -> dict[int, float]:
        """Return a term for violations of this rule, or no term if the rule is rigid."""
        if is_rigid:
            return {}
        column = self.column(upper)
        self.bends[column] = float(COSTS[code])
        return {column: 1.0}

    def solved(self, nodes: int, gap_ratio: float, time_s: float) -> OptimizeResult:
        """Minimise the objective; `gap_ratio` 0 requires a proof of optimality."""
        shape = (len(self.rows), len(self.upper))
        terms = [(i, j, value) for i, (row, _, _) in enumerate(self.rows) for j, value in sorted(row.items())]
        i, j, values = (np.array(column) for column in zip(*terms, strict=True))
        low, high = (np.array([row[end] for row in self.rows]) for end in (1, 2))
        cost = np.zeros(shape[1])
        cost[list(self.objective)] = list(self.objective.values())
        return milp(
            cost,
            integrality=np.array(self.whole),
            bounds=Bounds(np.zeros(shape[1]), np.array(self.upper)),
            constraints=LinearConstraint(csr_array((values.astype(float), (i, j)), shape=shape), low, high),
            options={"node_limit": nodes, "mip_rel_gap": gap_ratio, "time_limit": time_s},
        )


@dataclass(frozen=True)
class Model:
    """Three optimisation problems of a catalogue."""

    sought: SplitTask
    limits: SolverLimits

    def least_bent(self) -> SplitSolution:
        """Return the assignment that violates the rules at the lowest cost."""
        programme = self._programme(rules_of(self.sought), is_rigid=False)
        programme.objective = dict(programme.bends)
        return self._read(programme, self._proven(programme))

    def can_be_kept(self, rules: Iterable[Rule]) -> bool:
        """Return whether all of these rules are jointly feasible; also True if the solver cannot decide."""
        result = self._proven(self._programme(tuple(rules), is_rigid=True))
        return bool(result.status != INFEASIBLE)

    def most_alike(self, bent: SplitSolution) -> SplitSolution:
        """Return the assignment of equal or lower cost with the most similar parts, or `bent` if none is found in
        time.
        """
        programme = self._programme(rules_of(self.sought), is_rigid=bent.cost == 0)
        if programme.bends:
            programme.row(programme.bends, 0.0, float(bent.cost))
        _add_likeness(programme, self.sought)
        result = programme.solved(self.limits.likeness_nodes, self.limits.gap_ratio, self.limits.time_s)
        return self._read(programme, result) if result.x is not None else SplitSolution(bent.parts, bent.cost, False)

    def _proven(self, programme: Programme) -> OptimizeResult:
        return programme.solved(self.limits.rule_nodes, 0.0, self.limits.time_s)

    def _read(self, programme: Programme, result: OptimizeResult) -> SplitSolution:
        if result.x is None:  # no solution within the limits: nothing is assigned, at the cost of all sizes
            cost = COSTS[SIZES] * sum(self.sought.sizes)
            return SplitSolution((-1,) * len(self.sought.entries), cost, False)
        chosen = np.round(result.x[: 3 * len(self.sought.entries)]).astype(int).reshape(-1, 3)
        parts = tuple(int(row.argmax()) if row.any() else -1 for row in chosen)
        bent = sum(weight * round(result.x[column]) for column, weight in programme.bends.items())
        return SplitSolution(parts, int(bent), result.status == OPTIMAL)

    def _programme(self, rules: tuple[Rule, ...], *, is_rigid: bool) -> Programme:
        """Build the programme; x[s, p] is column 3 s + p."""
        programme, entries = Programme(), self.sought.entries
        for _ in range(3 * len(entries)):
            programme.column(1.0)
        for s in range(len(entries)):
            programme.row({3 * s + p: 1.0 for p in range(3)}, 0.0, 1.0)
        for rule in rules:
            ADDERS[rule.code](programme, self.sought, rule, is_rigid)
        return programme


OPTIMAL, INFEASIBLE = 0, 2


def _add_sizes(programme: Programme, sought: SplitTask, _rule: Rule, is_rigid: bool) -> None:
    for p, size in enumerate(sought.sizes):
        more = programme.bend(SIZES, float(len(sought.entries)), is_rigid=is_rigid)
        fewer = programme.bend(SIZES, float(size), is_rigid=is_rigid)
        members = {3 * s + p: 1.0 for s in range(len(sought.entries))}
        programme.row({**members, **{column: -1.0 for column in more}, **fewer}, float(size), float(size))


def _add_length(programme: Programme, sought: SplitTask, _rule: Rule, is_rigid: bool) -> None:
    for s, entry in enumerate(sought.entries):
        if not is_long_enough(entry):
            taken = programme.bend(LENGTH, 1.0, is_rigid=is_rigid)
            programme.row({3 * s + p: 1.0 for p in range(3)} | {column: -1.0 for column in taken}, -1.0, 0.0)


def _add_whole(programme: Programme, sought: SplitTask, _rule: Rule, is_rigid: bool) -> None:
    number = {entry.id: s for s, entry in enumerate(sought.entries)}
    for _, twins in twins_of(sought.entries):
        again = programme.bend(WHOLE, float(len(twins)), is_rigid=is_rigid)
        members = {3 * number[entry.id] + p: 1.0 for entry in twins for p in range(3)}
        programme.row(members | {column: -1.0 for column in again}, -float(len(twins)), 1.0)


def _add_drives(programme: Programme, sought: SplitTask, _rule: Rule, _is_rigid: bool) -> None:
    """Require each drive in at most one part; this rule is never violated, whatever the sizes."""
    number = {entry.id: s for s, entry in enumerate(sought.entries)}
    for _, members in drives_in(sought.entries):
        of_drive = [programme.column(1.0) for _ in PARTS]
        programme.row(dict.fromkeys(of_drive, 1.0), 0.0, 1.0)
        for entry in members:
            for p, column in enumerate(of_drive):
                programme.row({3 * number[entry.id] + p: 1.0, column: -1.0}, -1.0, 0.0)


def _add_regions(programme: Programme, sought: SplitTask, _rule: Rule, is_rigid: bool) -> None:
    of_test, shared = dict[str, int](), dict[str, dict[int, float]]()
    for s, entry in enumerate(sought.entries):
        key = entry.region_key
        if key not in of_test:
            of_test[key] = programme.column(1.0)
            shared[key] = programme.bend(REGIONS, 1.0, is_rigid=is_rigid)
        programme.row({3 * s + TEST: 1.0, of_test[key]: -1.0}, -1.0, 0.0)
        bent = {column: -1.0 for column in shared[key]}
        programme.row({3 * s + TRAIN: 1.0, of_test[key]: 1.0, **bent}, -1.0, 1.0)


def _add_condition(programme: Programme, sought: SplitTask, rule: Rule, is_rigid: bool) -> None:
    number = {entry.id: s for s, entry in enumerate(sought.entries)}
    for p, size in enumerate(sought.sizes):
        if size:
            missing = programme.bend(rule.code, 1.0, is_rigid=is_rigid)
            members = {3 * number[entry.id] + p: 1.0 for entry in rule.entries}
            programme.row(members | missing, 1.0, np.inf)


ADDERS = {
    SIZES: _add_sizes,
    LENGTH: _add_length,
    WHOLE: _add_whole,
    DRIVES: _add_drives,
    REGIONS: _add_regions,
    LIGHT: _add_condition,
    SEPARATED_PLACES: _add_condition,
}


def _add_likeness(programme: Programme, sought: SplitTask) -> None:
    """Add deviations of duration and class shares of each part, to be minimised."""
    whole = sums_of(sought.entries)
    shares, occupied, count = whole.class_shares(), sum(whole.voxels), max(len(sought.entries), 1)
    for p, size in enumerate(sought.sizes):
        if size and whole.duration_s:
            scale = count / (size * whole.duration_s)
            terms = {3 * s + p: entry.duration_s * scale for s, entry in enumerate(sought.entries)}
            _add_deviation(programme, terms, 1.0)
        for c in range(3) if size and shares else ():
            scale = count / (size * occupied)
            counted = ((s, entry.voxels) for s, entry in enumerate(sought.entries) if entry.voxels is not None)
            share = shares[c] if shares else 0.0
            _add_deviation(programme, {3 * s + p: (v[c] - share * sum(v)) * scale for s, v in counted}, 0.0)


def _add_deviation(programme: Programme, terms: Mapping[int, float], target: float) -> None:
    deviation = programme.column(np.inf, is_whole=False)
    programme.objective[deviation] = 1.0
    programme.row({**terms, deviation: -1.0}, -np.inf, target)
    programme.row({**terms, deviation: 1.0}, target, np.inf)
