"""The steps of a first submission as lines for a terminal, for one phase of this platform."""

from collections.abc import Iterator
from dataclasses import dataclass
from shlex import join

from api.client_wheel import ClientWheel, install_line
from services.domain.benchmarks.starter import FILENAME, manifest_filename

IN_ITS_OWN_PLACE = "python3 -m venv .venv && . .venv/bin/activate && "
"""Systems whose Python is managed refuse `pip install` outside a virtual environment (PEP 668)."""
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
    """The target of the steps: the platform's address, the wheel it serves, the phase, and the team if there is one."""

    url: str
    wheel: ClientWheel | None
    benchmark: str
    phase: str
    team: str | None = None


def predict_line(benchmark: str, phase: str) -> str:
    """Return the command that runs the starter code on the manifest, by their file names."""
    return join(("python", FILENAME, manifest_filename(benchmark, phase), ZIP))


def submission_steps(at: StepsPlace) -> tuple[SubmissionStep, ...]:
    """Return the steps from nothing to a scored submission; every name is quoted for the shell."""
    return tuple(_steps(at))


def _steps(at: StepsPlace) -> Iterator[SubmissionStep]:
    of_phase, manifest = (at.benchmark, at.phase), manifest_filename(at.benchmark, at.phase)
    wanted = ("--benchmark", at.benchmark, "--phase", at.phase)
    options = ("--team", at.team or TEAM, "--method", METHOD, "--modality", "L")
    if at.wheel is not None:
        line = f"{IN_ITS_OWN_PLACE}{install_line(at.url, at.wheel)}"
        yield SubmissionStep("Install the client", line, "Python 3.10 or newer.")
    yield SubmissionStep("Sign in", join(("stone", "auth", "login", at.url)))
    if at.team is None:
        yield SubmissionStep("Create a team", join(("stone", "team", "create", TEAM)), "Skip it if you have one.")
    yield SubmissionStep(
        "Get the manifest",
        join(("stone", "benchmark", "manifest", *of_phase, "-o", manifest)),
        "The frames to predict.",
    )
    inputs = join(("stone", "benchmark", "inputs", *of_phase, "-o", f"inputs/{at.phase}"))
    yield SubmissionStep("Get the inputs", inputs, "Sensor data, a tar per sequence.")
    starter = "It predicts flat ground; put your method in its place."
    fetch = join(("curl", "-fsSO", f"{at.url}/downloads/{FILENAME}"))
    yield SubmissionStep("Get the starter code", fetch, starter)
    yield SubmissionStep("Predict", predict_line(at.benchmark, at.phase))
    yield SubmissionStep("Validate", join(("stone", "validate", ZIP, "--manifest", manifest)))
    yield SubmissionStep(
        "Submit",
        join(("stone", "benchmark", "submit", ZIP, *wanted, *options)),
        "L is LiDAR; C camera, R radar, C+L both.",
    )
