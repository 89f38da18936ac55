"""All faults of published datasets: code, meaning, and the mistake that usually causes it."""

from dataclasses import asdict, dataclass
from typing import NamedTuple

from stone_base.errors import StoneError

QUOTED = 120


@dataclass(frozen=True)
class DatasetPlace:
    """The position of a fault: a file name within the dataset, and the row in a table."""

    file: str
    row: int | None = None
    token: str = ""

    def __str__(self) -> str:
        row = "" if self.row is None else f" row {self.row}"
        token = f" (token {self.token[:QUOTED]})" if self.token else ""
        return f"{self.file[: 2 * QUOTED]}{row}{token}"


class DatasetFault(NamedTuple):
    """The meaning of a code, and the mistake that usually causes it."""

    meaning: str
    likely: str


DATASET_FAULTS = {
    "DST-001": DatasetFault(
        "The dataset has neither a folder of tables nor an annotations.json.",
        "was its parent folder given, or a dataset in another layout?",
    ),
    "DST-002": DatasetFault("The dataset has tables in two folders.", "give one version, or the folder of one dataset"),
    "DST-003": DatasetFault(
        "The tar is compressed, so its files cannot be read by offset.",
        "`gunzip` the tar first; a zip is read directly",
    ),
    "DST-004": DatasetFault(
        "A path is absolute, contains `..` or a backslash, or is a link to a file outside the dataset.",
        "use paths relative to the dataset's folder; replace links by copies of their targets",
    ),
    "DST-005": DatasetFault("A table has more rows than the limit.", "is the file a table?"),
    "DST-006": DatasetFault(
        "The zip is cut off, has two files with the same name, or is ambiguous to different programs.",
        "was the download cut off? create the zip again with `zip -r`",
    ),
    "DST-007": DatasetFault(
        "Two files of the zip overlap, or a file overlaps the zip's directory.", "create the zip again"
    ),
    "DST-008": DatasetFault("A file of the zip is encrypted.", "create the zip without a password"),
    "DST-009": DatasetFault(
        "The decompressed files of the zip would be larger than any dataset.", "is the file a zip bomb?"
    ),
    "DST-010": DatasetFault("A table is missing.", "was the dataset unpacked completely?"),
    "DST-011": DatasetFault("A table is not JSON.", "was the download cut off?"),
    "DST-012": DatasetFault("A table is JSON, but not a list of rows.", "tables are `[{…}, …]`"),
    "DST-013": DatasetFault("A row of a table is not an object.", "tables are `[{…}, …]`"),
    "DST-014": DatasetFault("A table row is too long.", "is a quote or a bracket missing?"),
    "DST-015": DatasetFault("A row lacks a required key.", "was the dataset written by another version of the tool?"),
    "DST-016": DatasetFault(
        "A value does not have the type that the schema requires.", "does the value belong to another key?"
    ),
    "DST-017": DatasetFault(
        "A token is invalid. A frame token is 32 hex digits or a UUID of 32 hex digits; other tokens have 1 "
        "to 128 characters.",
        "frame tokens name the label folders and the submission files",
    ),
    "DST-018": DatasetFault(
        "Two rows of a table have the same token.", "were two datasets joined, or was one row written twice?"
    ),
    "DST-019": DatasetFault(
        "A scene's name is not a valid sequence name.",
        "use 1 to 100 letters, digits, dots, dashes and underscores; start with a letter or digit",
    ),
    "DST-020": DatasetFault("A number is NaN or infinite.", "did the localisation fail here?"),
    "DST-021": DatasetFault("A rotation is a 3 × 3 matrix.", "the schema requires a quaternion w x y z"),
    "DST-022": DatasetFault(
        "A quaternion does not have unit length.",
        "the order is w x y z; was the quaternion averaged without normalisation?",
    ),
    "DST-023": DatasetFault(
        "A translation is implausibly large.",
        "is it in millimetres instead of metres? if poses are UTM or ECEF, subtract the same whole metres "
        "from all of them",
    ),
    "DST-024": DatasetFault(
        "A camera matrix is not 3 × 3.", "is it the 3 × 4 projection matrix, or empty as for a LiDAR?"
    ),
    "DST-025": DatasetFault(
        "A camera matrix is singular, or not the matrix of a pinhole camera.",
        "does it have the form [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels?",
    ),
    "DST-026": DatasetFault(
        "A camera model is unknown, or its number of coefficients is wrong.",
        "coefficients: pinhole 0, plumb_bob 5, rational_polynomial 8, equidistant 4",
    ),
    "DST-027": DatasetFault(
        "The tables give several sizes, or none, for the images of a camera.",
        "`width` and `height` of sample_data are pixels and must be the same for all images of one calibration",
    ),
    "DST-028": DatasetFault(
        "A stamp is not in microseconds, or uses another clock than the frames.",
        "is it in seconds, milliseconds or nanoseconds?",
    ),
    "DST-030": DatasetFault(
        "A row refers to a token that the other table does not contain.", "were rows lost when the dataset was reduced?"
    ),
    "DST-031": DatasetFault("Two scenes have the same name.", "their labels would share a folder"),
    "DST-032": DatasetFault(
        "A scene's first or last sample contradicts its samples.",
        "was the scene shortened without updating its row?",
    ),
    "DST-033": DatasetFault(
        "A scene's nbr_samples differs from its number of samples.", "was the scene shortened without updating its row?"
    ),
    "DST-034": DatasetFault(
        "The prev and next links do not visit each row exactly once.",
        "was a row removed or inserted without linking its neighbours?",
    ),
    "DST-035": DatasetFault(
        "Stamps do not increase along the next links.", "did the clock jump, or are rows linked in the wrong order?"
    ),
    "DST-036": DatasetFault(
        "A frame has no LIDAR_TOP sweep, which defines the frame's pose.", "is the sweep not marked as a key frame?"
    ),
    "DST-037": DatasetFault(
        "A frame has two key-frame rows of the same sensor.", "is a sweep between key frames marked as a key frame?"
    ),
    "DST-038": DatasetFault(
        "A sensor has two calibrations within one scene.", "a sequence has one calibration: split the scene in two"
    ),
    "DST-039": DatasetFault(
        "A row of sample_data is more than 1 s from its frame.", "does it belong to another frame?"
    ),
    "DST-040": DatasetFault(
        "The stamp in a file name differs from the stamp of its row.", "does the row refer to a file of another frame?"
    ),
    "DST-041": DatasetFault(
        "A file's name or folder belongs to another sensor than its row.",
        "does the row refer to a file of another camera?",
    ),
    "DST-042": DatasetFault("Two rows refer to the same file.", "was a row copied without changing its file name?"),
    "DST-043": DatasetFault(
        "Some frame tokens are UUIDs with dashes, others are 32 hex digits without dashes.",
        "were two datasets joined? all tokens of one dataset must have the same form",
    ),
    "DST-044": DatasetFault(
        "Splits of the dataset divide a drive: consecutive scenes are in different splits.",
        "put whole drives into one split; an import of this dataset leaves the draft splits unchanged",
    ),
    "DST-045": DatasetFault(
        "The splits are not an object of lists of scene names.",
        'write one such file in the form {"train": ["scene", …], …}',
    ),
    "DST-046": DatasetFault("A split names a scene that does not exist.", "do the splits belong to a larger dataset?"),
    "DST-047": DatasetFault("A scene is in two splits.", "a method would be tested on a scene of its training data"),
    "DST-048": DatasetFault(
        "Rows that belong to several scenes would, when copied to each scene, take many times the size of the tables.",
        "do many or long rows of log, map, category or sensor belong to every scene?",
    ),
    "DST-049": DatasetFault(
        "A scene is too far from the origin of `global` for a voxel map.",
        "are the poses UTM or ECEF? subtract the same whole metres from all translations",
    ),
    "DST-050": DatasetFault("The file of a sample_data row is missing.", "was the dataset unpacked completely?"),
    "DST-051": DatasetFault(
        "A sweep does not consist of rows with five float32 values.",
        "expected are x y z intensity ring; is the file cut off, or does it have four columns?",
    ),
    "DST-052": DatasetFault(
        "A sweep contains points that are NaN or infinite.", "leave out shots without a return when you write the sweep"
    ),
    "DST-053": DatasetFault("An image is neither JPEG nor PNG.", "is the file empty, or a Git LFS pointer?"),
    "DST-054": DatasetFault("An image ends before its end marker.", "was the copy cut off?"),
    "DST-055": DatasetFault(
        "An image's size differs from the size in its row.", "was the image scaled without its intrinsics?"
    ),
    "DST-056": DatasetFault(
        "A radar scan is not a binary PCD with the required fields.",
        "expected are x y z rcs vx_comp vy_comp, as in nuScenes",
    ),
    "DST-060": DatasetFault(
        "A frame of a labelled scene has no labels.",
        "expected is gts/<scene>/<frame token>/labels.npz; was the dataset unpacked completely?",
    ),
    "DST-061": DatasetFault("A label file is not an npz file.", "was the copy cut off?"),
    "DST-062": DatasetFault(
        "A label file lacks the array of classes.",
        "expected is `semantics` in the paper's and Occ3D's layout, `label` in the release's; was another "
        "--layout given?",
    ),
    "DST-063": DatasetFault(
        "Labels have another grid than the given grid or the first labels.",
        "was the wrong --grid given, or are labels of two datasets mixed?",
    ),
    "DST-064": DatasetFault("Labels have the wrong dtype or memory order.", "expected is uint8 in C order"),
    "DST-065": DatasetFault(
        "Labels are larger than a grid, compressed or decompressed.", "is the file a zip bomb, or a grid of floats?"
    ),
    "DST-066": DatasetFault(
        "Labels contain values without a meaning.",
        "define the values with --classes; labels with 18 classes usually follow Occ3D, where 17 is free",
    ),
    "DST-067": DatasetFault(
        "A mask is not a uint8 grid with the labels' shape.", "is it a pixel mask, or a mask of another grid?"
    ),
    "DST-068": DatasetFault("A mask contains other values than 0 and 1.", "is the value 255 used for true?"),
    "DST-069": DatasetFault(
        "annotations.json has another label path than gts/<scene>/<frame token>/labels.npz.",
        "is it the annotations.json of another dataset?",
    ),
    "DST-070": DatasetFault(
        "The class map is invalid.",
        "expected is `name: my-set` and `classes: {0: free, 11: T, 12: P, 13: N, 255: unobserved}`",
    ),
    "DST-071": DatasetFault(
        "All labels of a scene are free in all frames.",
        "does --classes map every class to free, or are the labels of a test set blanked?",
    ),
    "DST-072": DatasetFault(
        "The labels of a scene occupy more voxels in part of its map than a surface can.",
        "do the poses climb without end, or does --classes map free space to an occupied class?",
    ),
    "DST-073": DatasetFault(
        "Sweeps, labels and tables do not match: the returns of frames are not in occupied voxels.",
        "set the grid with --grid; quaternions have the order w x y z",
    ),
    "DST-074": DatasetFault(
        "The returns of a frame match the labels of another frame.",
        "were frames or scenes mixed up, or numbered differently, when labels or sweeps were written?",
    ),
}


class DatasetFaultError(StoneError):
    """A published dataset has the fault `code` of `DATASET_FAULTS`.

    Errors from a sandboxed process contain only the sentence, which already counts the other rows.
    """

    rows = 1

    def __init__(self, code: str, place: DatasetPlace, what: str, likely: str = "") -> None:
        """`likely` is the mistake, if the value itself shows it; `rows` of one file with the same mistake are then one
        fault.
        """
        super().__init__(f"{place}: {what} ({likely or DATASET_FAULTS[code].likely})")
        self.code, self.place, self.likely = code, place, likely

    def __str__(self) -> str:
        others = f"; {self.rows - 1} more rows of this file have the same fault" if self.rows > 1 else ""
        return f"{super().__str__()}{others}"

    def as_record(self) -> dict[str, object]:
        return {"code": self.code, **asdict(self.place), "message": str(self), "rows": self.rows}
