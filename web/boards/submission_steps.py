"""The steps of a first submission as lines for a terminal, for one phase of this platform."""

from collections.abc import Iterator
from dataclasses import dataclass
from shlex import join

from api.client_wheel import ClientWheel, install_line

TEAM, METHOD = "My team", "My method"
ZIP = "run.zip"


@dataclass(frozen=True)
class SubmissionStep:
    """One step: its title, the line to paste, and what it does where the line does not say so."""

    title: str
    line: str
    hint: str = ""


@dataclass(frozen=True)
class StepsPlace:
    """Where the steps lead: the platform's address, the wheel it serves, and the phase."""

    url: str
    wheel: ClientWheel | None
    benchmark: str
    phase: str
    team: str = TEAM


def submission_steps(at: StepsPlace) -> tuple[SubmissionStep, ...]:
    """From nothing to a scored submission; every name is quoted as a shell needs it."""
    return tuple(_steps(at))


def _steps(at: StepsPlace) -> Iterator[SubmissionStep]:
    of_phase, manifest = (at.benchmark, at.phase), f"{at.phase}.json"
    wanted = ("--benchmark", at.benchmark, "--phase", at.phase)
    said = ("--team", at.team, "--method", METHOD, "--modality", "L")
    if at.wheel is not None:
        yield SubmissionStep("Install the client", install_line(at.url, at.wheel), "Python 3.11 or newer.")
    yield SubmissionStep("Sign in", join(("stone", "login", at.url)))
    yield SubmissionStep("Create a team", join(("stone", "teams", "create", at.team)), "Skip it if you have one.")
    yield SubmissionStep(
        "Get the manifest", join(("stone", "manifest", *of_phase, "-o", manifest)), "The frames to predict."
    )
    inputs = join(("stone", "inputs", *of_phase, "-o", f"inputs/{at.phase}"))
    yield SubmissionStep("Get the inputs", inputs, "Sensor data, a tar per sequence.")
    starter = "The starter code predicts flat ground; put your method in its place."
    yield SubmissionStep("Predict", join(("python", "predict.py", manifest, ZIP)), starter)
    yield SubmissionStep("Validate", join(("stone", "validate", ZIP, "--manifest", manifest)))
    yield SubmissionStep(
        "Submit", join(("stone", "submit", ZIP, *wanted, *said)), "L is LiDAR; C camera, R radar, C+L both."
    )
