"""Refusals of submissions, manifests and ground truth.

**Conventions.** A `SubmissionError` is the fault of one file: it contains the expected and the actual value, and the
caller adds file and frame. The codes are those of the design's §9, and a few additional ones.
"""

import re
from pathlib import Path

from stone_base.errors import Refused, StoneError
from stone_base.label_grid import LabelGrid
from stone_submissions.other_layouts import layout_hint, resaved

NUMBERS = re.compile(r"'[<>|=]?([bif])[0-9]{1,2}'")
BITS = " (bool is not a class: was the prediction thresholded?)"
SHAPE = re.compile(r"\((\d{1,4}), (\d{1,4}), (\d{1,4})\)")

MISTAKES = {
    "missing_frame": "a submission contains every frame of the manifest; was the prediction loop cut short?",
    "unexpected_file": "name files <frame_token>.npz and put all of them in one folder or at the top level",
    "other_layout": "name files <frame_token>.npz and put all of them in one folder or at the top level",
    "duplicate_frame": "was the archive appended to instead of rewritten?",
    "not_zip": "a submission is a zip archive of .npz files; was the upload cut short?",
    "not_npz": "write frames with numpy.savez_compressed",
    "truncated": "was the file cut off when it was written or copied?",
    "corrupt": "the bytes changed after the file was written; upload it again",
    "too_large": "a frame is one uint8 grid; was it saved as int64, or with other arrays?",
    "extra_array": "save only the prediction",
    "missing_array": "set the array's name: numpy.savez_compressed(path, semantics=grid)",
    "bad_shape": "axes are x, y, z, in C order",
    "bad_dtype": "cast with .astype(numpy.uint8) before saving",
    "label_out_of_range": "0 free, 1 T, 2 P, 3 N; does your prediction use 255 for unknown, or another class map?",
    "encrypted": "password-protected archives are not accepted",
    "unsupported_zip": "create the zip in one part with method deflate or store, as zip or Python's zipfile do",
    "overlapping_files": "entries of the zip overlap; create the zip again",
    "symlink": "zip the files themselves, not links to them",
}
"""The most frequent cause of each file fault; `hint_of` is more specific for some codes."""


def bad_shape(grid: LabelGrid, found: str) -> "SubmissionError":
    """Return the refusal of an array whose shape or order is `found`."""
    return SubmissionError("bad_shape", str(grid.shape), found)


def shape_hint(expected: str, found: str) -> str:
    """Return how to convert a frame with the shape or order `found` to the expected shape; both as in `bad_shape`."""
    wanted = SHAPE.match(expected)
    if wanted is None:
        return MISTAKES["bad_shape"]
    x, y, z = map(int, wanted.groups())
    step = {
        str((z, x, y)): "grid.transpose(1, 2, 0) if your axes are z, x, y; grid.transpose(2, 1, 0) if they are z, y, x",
        str((x, z, y)): "grid.transpose(0, 2, 1) if your axes are x, z, y; grid.transpose(2, 0, 1) if they are y, z, x",
        str((1, x, y, z)): "grid[0]: a frame has no batch axis",
        str((x, y, z, 1)): "grid[..., 0]: a frame has no channel axis",
        str((4, x, y, z)): "grid.argmax(0): a frame contains one class per voxel, not a score per class",
        str((x, y, z, 4)): "grid.argmax(-1): a frame contains one class per voxel, not a score per class",
        "Fortran order": "numpy.ascontiguousarray(grid)",
    }.get(found)
    if step is not None:
        return f"axes are x, y, z: {step}"
    return f"axes are x, y, z, with {x} × {y} × {z} voxels, in C order"


def hint_of(code: str, expected: str, found: str) -> str:
    """Return the cause of a fault and its fix, from the expected and actual value in the problem."""
    if code == "bad_shape":
        return shape_hint(expected, found)
    line = layout_hint(found) if code in ("other_layout", "unexpected_file") else ""
    if code == "missing_array" and found.isidentifier():
        return f"{MISTAKES[code]}; " + resaved(f"f['{found}']")
    if code == "bad_dtype" and (dtype := NUMBERS.fullmatch(found)):
        return f"{MISTAKES[code]}{BITS if dtype[1] == 'b' else ''}; " + resaved("f[f.files[0]].astype('uint8')")
    return line or MISTAKES[code]


class SubmissionError(StoneError):
    """A file of a submission, or the archive itself, has the fault `code` of `MISTAKES`."""

    def __init__(self, code: str, expected: str, actual: str) -> None:
        self.code, self.expected, self.actual = code, expected, actual
        super().__init__(f"expected {expected}, found {actual} ({hint_of(code, expected, actual)})")


def bad_manifest(path: Path, fault: str) -> Refused:
    return Refused(
        "bad_manifest", f"manifest {path}: {fault}; create the manifest from the ground truth with this program"
    )


class GroundTruthError(StoneError):
    """The ground truth folder, or a label file in it, does not have the labeler's format."""

    code = "bad_ground_truth"

    def __init__(self, path: Path, fault: str) -> None:
        super().__init__(f"ground truth {path}: {fault}; expected gts/<sequence>/<frame_token>/labels.npz")


class UnreadableInputError(StoneError):
    """A given file cannot be opened."""

    code = "unreadable_input"

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path} cannot be read: {reason}; is the path right?")
