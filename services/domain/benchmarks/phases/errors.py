"""Errors of creating and changing benchmarks and phases."""

from stone.errors import StoneError


class BadPhaseError(StoneError):
    """The rules of a phase contradict themselves or are out of range."""

    code = "bad_phase"

    def __init__(self, field: str, value: object, expected: str) -> None:
        super().__init__(f"{field} is {str(value)[:80]!r}; expected {expected}")


class EmptyPartError(StoneError):
    """The dataset version has no sequence in the part that was asked for."""

    code = "empty_part"

    def __init__(self, dataset: str, part: str) -> None:
        super().__init__(
            f"version {dataset!r} has no sequence in {part}; publish one that does, or choose another part"
        )


class OpenTestError(StoneError):
    """An open phase over test would tell exactly what is hidden."""

    code = "open_test"

    def __init__(self, part: str) -> None:
        super().__init__(f"the labels of {part} are hidden, and an open phase shows exact results; make it hidden")


class PhaseFixedError(StoneError):
    """What a phase evaluates does not change under a ground truth that stands."""

    code = "phase_fixed"

    def __init__(self, phase: str, fields: str) -> None:
        super().__init__(f"phase {phase!r} has a ground truth, so {fields} cannot change; add another phase instead")


class PhaseEndedError(StoneError):
    """A hidden phase that has ended told its results by sequence, and is not opened again."""

    code = "phase_ended"

    def __init__(self, phase: str) -> None:
        super().__init__(
            f"hidden phase {phase!r} has ended and its results by sequence were shown; add another phase instead"
        )


class NoGroundTruthError(StoneError):
    """The phase has no ground truth yet."""

    code = "no_ground_truth"

    def __init__(self, phase: str) -> None:
        super().__init__(
            f"phase {phase!r} has no ground truth yet; an administrator has one made from a dataset version"
        )


class TruthInMakingError(StoneError):
    """Another ground truth of the phase is being made."""

    code = "truth_in_making"

    def __init__(self, number: int, job_id: str) -> None:
        super().__init__(f"ground truth {number} is being made by job {job_id}; wait for it or cancel it first")


class OtherFramesError(StoneError):
    """A new ground truth has other frames than the entries of the phase."""

    code = "other_frames"

    def __init__(self, missing: int, extra: int) -> None:
        super().__init__(
            f"{missing} frame(s) of the active ground truth are not in this version and {extra} are new; the entries "
            "could not be scored again, so make a new phase of this version"
        )


class FramesUncomparedError(StoneError):
    """The active ground truth changed while the frames were compared."""

    code = "truth_changed"

    def __init__(self, phase: str) -> None:
        super().__init__(f"the active ground truth of phase {phase!r} changed in the meantime; reload and retry")
