"""Why a submission, a manifest or a ground truth is refused: one leaf a code.

**Conventions.** What is wrong with one file of a submission is a `SubmissionError`: it knows what was expected and what
was found; whoever reads knows the file and the frame. Codes are those of the design's §9, and a few more where none of
those fits.
"""

from pathlib import Path

from stone_base.errors import PlatformFaultError, StoneError

TO_XYZ = {
    "(32, 256, 256)": "grid.transpose(1, 2, 0) if its axes are z, x, y; grid.transpose(2, 1, 0) if z, y, x",
    "(256, 32, 256)": "grid.transpose(0, 2, 1) if its axes are x, z, y; grid.transpose(2, 0, 1) if y, z, x",
    "(1, 256, 256, 32)": "grid[0]: a frame has no batch axis",
    "(256, 256, 32, 1)": "grid[..., 0]: a frame has no channel axis",
    "(4, 256, 256, 32)": "grid.argmax(0): a frame holds one class per voxel, not a score per class",
    "(256, 256, 32, 4)": "grid.argmax(-1): a frame holds one class per voxel, not a score per class",
    "Fortran order": "numpy.ascontiguousarray(grid)",
}
AXES = "axes are x, y, z, with 256 × 256 × 32 voxels of 0.2 m, in C order"


def shape_hint(found: str) -> str:
    """What makes a frame of the shape or order `found`, as `BadShapeError` tells it, one of (256, 256, 32)."""
    step = TO_XYZ.get(found)
    return AXES if step is None else f"axes are x, y, z: {step}"


class SubmissionError(StoneError):
    """A file of a submission, or the archive itself, is not valid; `mistake` is the most frequent cause."""

    mistake: str

    def __init__(self, expected: str, actual: str) -> None:
        self.expected, self.actual = expected, actual
        super().__init__(f"expected {expected}, found {actual} ({self.mistake})")


class MissingFrameError(SubmissionError):
    code = "missing_frame"
    mistake = "a submission holds every frame of the manifest; was the prediction loop cut short?"


class UnexpectedFileError(SubmissionError):
    code = "unexpected_file"
    mistake = "files are named <frame_token>.npz, all in one folder or all at the top level"


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

    def __init__(self, expected: str, actual: str) -> None:
        self.mistake = shape_hint(actual)
        super().__init__(expected, actual)


class BadDtypeError(SubmissionError):
    code = "bad_dtype"
    mistake = "cast with .astype(numpy.uint8) before saving"


class LabelOutOfRangeError(SubmissionError):
    code = "label_out_of_range"
    mistake = "0 free, 1 T, 2 P, 3 N; is 'unknown' written as 255, or another class map?"


class EncryptedError(SubmissionError):
    code = "encrypted"
    mistake = "password-protected archives are not accepted"


class UnsupportedZipError(SubmissionError):
    code = "unsupported_zip"
    mistake = "zip with method deflate or store, in one part, as zip or Python's zipfile do"


class OverlapError(SubmissionError):
    code = "overlapping_files"
    mistake = "entries of the zip overlap; write it again"


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
    """Reading or scoring a submission crashed its process or exceeded its limits; a retry would do the same."""

    code = "scoring_crashed"

    def __init__(self, fate: str) -> None:
        super().__init__(f"the process that read the submission {fate}; was it written by numpy.savez_compressed?")


class ScoringInterruptedError(PlatformFaultError):
    """Reading or scoring a submission was interrupted by the machine; the input is probably not the cause."""

    code = "scoring_interrupted"

    def __init__(self, fate: str) -> None:
        super().__init__(f"the process that read the submission {fate}; it is tried again")
