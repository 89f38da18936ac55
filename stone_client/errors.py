"""Errors of commands that talk to a server.

**Conventions.** A server's own code and sentence are passed on as they are, with the id of the request that its
administrator can look up.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

from stone_base.errors import StoneError

MOST_FINDINGS = 5


class ServerRefusedError(StoneError):
    """The server answered with a problem; `code` is its code, not the class's."""

    code: ClassVar[str] = "server_refused"

    def __init__(self, status: int, problem: Mapping[str, Any], retry_after_s: float | None = None) -> None:
        self.status, self.problem, self.retry_after_s = status, dict(problem), retry_after_s
        self.code = str(problem.get("code") or type(self).code)  # type: ignore[misc] # the server names the reason
        sentence = str(problem.get("detail") or problem.get("title") or f"the server answered {status}")
        request_id = problem.get("request_id")
        super().__init__(sentence + _findings(problem) + (f" (request {request_id})" if request_id else ""))


class ServerFaultError(StoneError):
    """The answer is not one of the platform: a fault, a proxy's page, another program on that port."""

    code: ClassVar[str] = "server_fault"

    def __init__(self, status: int, url: str, text: str) -> None:
        said = text.strip()[:200]
        super().__init__(f"{url} answered {status} without a reason of the platform{f': {said}' if said else ''}")
        self.status = status


class ServerUnreachableError(StoneError):
    """Nothing answers at the URL, or the connection kept breaking."""

    code: ClassVar[str] = "server_unreachable"

    def __init__(self, url: str, reason: str) -> None:
        super().__init__(f"{url} cannot be reached: {reason}; is it running (`stone serve`), and is the URL right?")


class NoServerError(StoneError):
    """No server was named, and none is remembered."""

    code: ClassVar[str] = "no_server"

    def __init__(self) -> None:
        super().__init__("no server configured; run `stone serve` here, `stone login URL`, or set STONE_URL")


class ServerTooOldError(StoneError):
    """The server is of a release that this client does not understand any more."""

    code: ClassVar[str] = "server_too_old"

    def __init__(self, url: str, release: str, oldest: str) -> None:
        super().__init__(
            f"{url} is of release {release[:40]}, this client understands {oldest} and newer; its administrator may "
            f"update it, or install the client that it offers at {url}/downloads/"
        )


class NotSignedInError(StoneError):
    """There is no token for the server."""

    code: ClassVar[str] = "not_signed_in"

    def __init__(self, url: str) -> None:
        super().__init__(f"there is no token for {url}; run `stone login {url}`, or set STONE_TOKEN")


class BadUrlError(StoneError):
    """What was given is no address of a server."""

    code: ClassVar[str] = "bad_url"

    def __init__(self, url: str) -> None:
        super().__init__(f"{url!r} is not a server URL; expected for example http://127.0.0.1:8080")


class BadCredentialsFileError(StoneError):
    """The file of tokens was changed by hand, or by another program."""

    code: ClassVar[str] = "bad_credentials_file"

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path} cannot be read as credentials: {reason}; remove it and run `stone login`")


class FileChangedError(StoneError):
    """The file is not the one whose upload began."""

    code: ClassVar[str] = "file_changed"

    def __init__(self, path: Path) -> None:
        super().__init__(
            f"{path} changed while it was uploaded; is it still being written? Upload it again when it is done"
        )


class ServerRefusedRecordingError(StoneError):
    """The server read the recording and cannot use it; `code` is that of the first finding."""

    code: ClassVar[str] = "recording_refused"

    def __init__(self, filename: str, code: str, sentence: str) -> None:
        self.code = code or type(self).code  # type: ignore[misc] # the finding names the reason
        super().__init__(f"{filename}: {sentence}")


class JobFailedError(StoneError):
    """A job ended badly; `code` is that of its failure."""

    code: ClassVar[str] = "job_failed"

    def __init__(self, job: Mapping[str, Any]) -> None:
        failure = job.get("failure") or {}
        self.job = dict(job)
        self.code = str(failure.get("code") or job["state"])  # type: ignore[misc] # the failure names the reason
        reason = failure.get("sentence") or job.get("cancel_reason") or f"it was {job['state']}"
        super().__init__(f"{job['kind']} {job['id']} {job['state']}: {reason}")


class UnknownSubjectError(StoneError):
    """The name or id is neither a sequence nor a job of the caller's."""

    code: ClassVar[str] = "not_found"

    def __init__(self, subject: str) -> None:
        super().__init__(f"no sequence and no job of yours is called {subject!r}; `stone status` lists your sequences")


class NoSuchRecordingError(StoneError):
    """The sequence has no recording of that name or id."""

    code: ClassVar[str] = "not_found"

    def __init__(self, subject: str, known: Sequence[str]) -> None:
        super().__init__(f"the sequence has no recording {subject!r}; it has {', '.join(known) or 'none'}")


class NoLabelsError(StoneError):
    """The sequence has no labels to download yet."""

    code: ClassVar[str] = "no_labels"

    def __init__(self, name: str) -> None:
        super().__init__(f"sequence {name!r} has no labels yet; run `stone process {name} --watch`")


class NoExportError(StoneError):
    """The sequence has no finished export of its labels in this format."""

    code: ClassVar[str] = "no_export"

    def __init__(self, name: str, form: str, state: str) -> None:
        why = f"its {form} export is {state}" if state else f"it has no {form} export of its labels"
        super().__init__(
            f"sequence {name!r} cannot be downloaded so: {why}; run `stone exports {name} --format {form}`"
        )


class DownloadUnderWayError(StoneError):
    """Another process is downloading to the same place."""

    code: ClassVar[str] = "download_under_way"

    def __init__(self, output: Path) -> None:
        super().__init__(f"another process is downloading {output}; wait for it, or choose another output path")


class DamagedDownloadError(StoneError):
    """What arrived is not what the server said it would send."""

    code: ClassVar[str] = "damaged_download"

    def __init__(self, path: str, found: str, promised: str) -> None:
        super().__init__(f"{path} has sha256 {found}, expected {promised or 'none'}; download it again")


def _findings(problem: Mapping[str, Any]) -> str:
    """The first few things that are wrong, where the server names several."""
    found = problem.get("errors") or []
    said = [f"{one.get('where', '')}: {one.get('expected') or one.get('code', '')}" for one in found[:MOST_FINDINGS]]
    return f": {'; '.join(said)}" if said else ""


class PlatformNotInstalledError(StoneError):
    """The command works on recordings, labels or models, which the client alone cannot."""

    code: ClassVar[str] = "platform_not_installed"

    def __init__(self, command: str) -> None:
        super().__init__(
            f"`stone {command}` needs the platform, and here is only its client: install the distribution "
            "stone-platform beside it, or run the command in a checkout of the platform (`make install`)"
        )


class UnknownCodeError(StoneError):
    """No finding and no failed run has this code."""

    code: ClassVar[str] = "unknown_code"

    def __init__(self, given: str) -> None:
        super().__init__(f"{given[:80]!r} is no code of a finding or of a failed run; `stone explain` lists them")
