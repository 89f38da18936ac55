"""Why a submission, a manifest or a ground truth is refused: one leaf a code.

**Conventions.** What is wrong with one file of a submission is a `SubmissionError`: it knows what was expected and what
was found; whoever reads knows the file and the frame. Codes are those of the design's §9, and a few more where none of
those fits.
"""

from pathlib import Path
from typing import ClassVar

from stone_base.errors import PlatformFaultError, StoneError


class SubmissionError(StoneError):
    """One file of a submission, or the archive itself, is not as agreed; `mistake` is what most often causes it."""

    mistake: ClassVar[str]

    def __init__(self, expected: str, actual: str) -> None:
        self.expected, self.actual = expected, actual
        super().__init__(f"expected {expected}, found {actual} ({self.mistake})")


class MissingFrameError(SubmissionError):
    code = "missing_frame"
    mistake = "a submission holds every frame of the manifest; was the prediction loop cut short?"


class UnexpectedFileError(SubmissionError):
    code = "unexpected_file"
    mistake = "files are named <frame_token>.npz, all in one folder or in none"


class DuplicateFrameError(SubmissionError):
    code = "duplicate_frame"
    mistake = "was the archive appended to instead of rewritten?"


class NotZipError(SubmissionError):
    code = "not_zip"
    mistake = "a submission is a zip archive of .npz files; was the upload cut short?"


class NotNpzError(SubmissionError):
    code = "not_npz"
    mistake = "write frames with numpy.savez_compressed"


class TruncatedError(SubmissionError):
    code = "truncated"
    mistake = "was the file cut short while it was written or copied?"


class CorruptError(SubmissionError):
    code = "corrupt"
    mistake = "the bytes changed after they were written; upload again"


class TooLargeError(SubmissionError):
    code = "too_large"
    mistake = "a frame is one uint8 grid; was it saved as int64, or with more arrays?"


class ExtraArrayError(SubmissionError):
    code = "extra_array"
    mistake = "save the prediction alone"


class MissingArrayError(SubmissionError):
    code = "missing_array"
    mistake = "name it: numpy.savez_compressed(path, semantics=grid)"


class BadShapeError(SubmissionError):
    code = "bad_shape"
    mistake = "axes are x, y, z in C order; numpy.ascontiguousarray mends a Fortran or transposed array"


class BadDtypeError(SubmissionError):
    code = "bad_dtype"
    mistake = "cast with .astype(numpy.uint8) before saving"


class LabelOutOfRangeError(SubmissionError):
    code = "label_out_of_range"
    mistake = "0 free, 1 T, 2 P, 3 N; is 'unknown' written as 255, or another class map?"


class EncryptedError(SubmissionError):
    code = "encrypted"
    mistake = "archives carry no password"


class UnsupportedZipError(SubmissionError):
    code = "unsupported_zip"
    mistake = "zip with method deflate or store, in one part, as zip or Python's zipfile do"


class OverlapError(SubmissionError):
    code = "overlapping_files"
    mistake = "no honest archive shares bytes between files; rewrite it"


class SymlinkError(SubmissionError):
    code = "symlink"
    mistake = "zip the files themselves, not links to them"


class ManifestError(StoneError):
    """The list of frames to predict is not as `stone_submissions.manifest` describes."""

    code = "bad_manifest"

    def __init__(self, path: Path, fault: str) -> None:
        super().__init__(f"manifest {path}: {fault}; a manifest is written from the ground truth by this program")


class GroundTruthError(StoneError):
    """The ground truth folder, or a label file in it, is not as the labeler writes it."""

    code = "bad_ground_truth"

    def __init__(self, path: Path, fault: str) -> None:
        super().__init__(f"ground truth {path}: {fault}; expected gts/<sequence>/<frame_token>/labels.npz")


class UnreadableInputError(StoneError):
    """A file that was named cannot be opened."""

    code = "unreadable_input"

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path} cannot be read: {reason}; is the path right?")


class ScoringCrashedError(StoneError):
    """Reading or counting a submission broke its process or its limits; the same bytes would do so again."""

    code = "scoring_crashed"

    def __init__(self, fate: str) -> None:
        super().__init__(f"the process that read the submission {fate}; was it written by numpy.savez_compressed?")


class ScoringInterruptedError(PlatformFaultError):
    """Reading or counting a submission was cut short by the machine; perhaps no fault of the input."""

    code = "scoring_interrupted"

    def __init__(self, fate: str) -> None:
        super().__init__(f"the process that read the submission {fate}; it is tried again")
