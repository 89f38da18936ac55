"""Every fault that a published dataset may have: its code, what it means, and the mistake that usually causes it."""

from dataclasses import asdict, dataclass
from typing import NamedTuple

from stone_base.errors import StoneError

QUOTED = 120


@dataclass(frozen=True)
class DatasetPlace:
    """Where a fault is: a file of the dataset, by its name there, and the row where it is a table's."""

    file: str
    row: int | None = None
    token: str = ""

    def __str__(self) -> str:
        row = "" if self.row is None else f" row {self.row}"
        token = f" (token {self.token[:QUOTED]})" if self.token else ""
        return f"{self.file[: 2 * QUOTED]}{row}{token}"


class DatasetFault(NamedTuple):
    """What a code means, and the mistake that usually causes it."""

    meaning: str
    likely: str


DATASET_FAULTS = {
    "DST-001": DatasetFault(
        "There is neither a folder of tables nor an annotations.json.",
        "is it the folder above, or a set of another layout?",
    ),
    "DST-002": DatasetFault("There are tables in two places.", "give one version, or the folder of one dataset"),
    "DST-003": DatasetFault(
        "The tar is compressed, so that no file in it can be read by its place.",
        "`gunzip` it first; a zip is read as it is",
    ),
    "DST-004": DatasetFault(
        "A path is absolute, has `..` or a backslash, or is a link to outside of the dataset.",
        "paths are relative to the dataset's folder; copy what a link leads to",
    ),
    "DST-005": DatasetFault("A table has more rows than are read.", "is it a table at all?"),
    "DST-006": DatasetFault(
        "The zip is cut off, has two files of one name, or is none that every program reads alike.",
        "was the download cut off? write it again with `zip -r`",
    ),
    "DST-007": DatasetFault("Two files of the zip overlap, or one overlaps its directory.", "write the zip again"),
    "DST-008": DatasetFault("A file of the zip is encrypted.", "write the zip without a password"),
    "DST-009": DatasetFault(
        "The files of the zip would inflate to more bytes than any dataset's do.", "is it a zip bomb?"
    ),
    "DST-010": DatasetFault("A table is missing.", "was the dataset unpacked completely?"),
    "DST-011": DatasetFault("A table is not JSON.", "was the download cut off?"),
    "DST-012": DatasetFault("A table is JSON, but not a list of rows.", "tables are `[{…}, …]`"),
    "DST-013": DatasetFault("A row of a table is not an object.", "tables are `[{…}, …]`"),
    "DST-014": DatasetFault("A row of a table is longer than any row can be.", "is a quote or a bracket missing?"),
    "DST-015": DatasetFault("A row lacks a key that is needed.", "was it written by another version of the tool?"),
    "DST-016": DatasetFault("A value is of another type than the schema says.", "is it the value of another key?"),
    "DST-017": DatasetFault(
        "A token is invalid: a frame token is 32 hex digits or a UUID of them, any other 1 to 128 characters.",
        "frame tokens name the folders of labels and the files of submissions",
    ),
    "DST-018": DatasetFault(
        "Two rows of a table have one token.", "were two datasets joined, or was one row written twice?"
    ),
    "DST-019": DatasetFault(
        "The name of a scene cannot name a sequence.",
        "1 to 100 letters, digits, dots, dashes and underscores, the first a letter or digit",
    ),
    "DST-020": DatasetFault("A number is NaN or infinite.", "did the localisation fail here?"),
    "DST-021": DatasetFault("A rotation is a 3 × 3 matrix.", "the schema wants a quaternion w x y z"),
    "DST-022": DatasetFault(
        "A quaternion is not of unit length.", "the order is w x y z; was it averaged without normalising?"
    ),
    "DST-023": DatasetFault(
        "A translation is beyond any plausible distance.",
        "are they metres, and not millimetres? of poses in UTM or ECEF, subtract the same whole metres from all",
    ),
    "DST-024": DatasetFault("A camera's matrix is not 3 × 3.", "is it the 3 × 4 projection, or empty as a LiDAR's?"),
    "DST-025": DatasetFault(
        "A camera's matrix is singular, or not that of a pinhole camera.",
        "is it [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels?",
    ),
    "DST-026": DatasetFault(
        "A camera's model is not known, or has another number of coefficients.",
        "pinhole 0, plumb_bob 5, rational_polynomial 8, equidistant 4",
    ),
    "DST-027": DatasetFault(
        "The tables do not give one size for the images of a camera.",
        "`width` and `height` of sample_data are pixels, of one calibration always the same",
    ),
    "DST-028": DatasetFault(
        "A stamp is not in microseconds, or is of another clock than the frames.",
        "seconds, milliseconds or nanoseconds?",
    ),
    "DST-030": DatasetFault(
        "A row names a token that the other table does not have.", "were rows left out when the dataset was cut?"
    ),
    "DST-031": DatasetFault("Two scenes have the same name.", "their labels would be in the same folder"),
    "DST-032": DatasetFault(
        "A scene's first or last sample is another than its samples say.",
        "was the scene shortened without updating its row?",
    ),
    "DST-033": DatasetFault(
        "A scene's nbr_samples is not the number of its samples.", "was the scene shortened without updating its row?"
    ),
    "DST-034": DatasetFault(
        "prev and next do not lead through all rows once.",
        "was a row left out, or put in, without linking its neighbours?",
    ),
    "DST-035": DatasetFault(
        "Stamps do not increase along next.", "did the clock jump, or are rows linked in another order?"
    ),
    "DST-036": DatasetFault(
        "A frame has no LIDAR_TOP sweep, whose pose is the frame's pose.", "is the sweep not a key frame?"
    ),
    "DST-037": DatasetFault(
        "A frame has two key-frame rows of one sensor.", "is a sweep between key frames marked as one?"
    ),
    "DST-038": DatasetFault(
        "A sensor has two calibrations within one scene.", "a sequence has one calibration: cut the scene in two"
    ),
    "DST-039": DatasetFault(
        "A row of sample_data is more than a second from its frame.", "does it belong to another frame?"
    ),
    "DST-040": DatasetFault(
        "A file's name has another stamp than its row.", "does the row name the file of another frame?"
    ),
    "DST-041": DatasetFault(
        "A file's name or folder is of another sensor than its row.", "does the row name the file of another camera?"
    ),
    "DST-042": DatasetFault("Two rows name one file.", "was a row copied without changing its file name?"),
    "DST-043": DatasetFault(
        "Some frame tokens are UUIDs with dashes, others 32 hex digits without.",
        "were two datasets joined? all tokens of one have one form",
    ),
    "DST-044": DatasetFault(
        "Splits of the dataset tear a drive: scenes that continue each other are in two.",
        "put whole drives into a split; an import of it leaves the draft splits as they are",
    ),
    "DST-045": DatasetFault(
        "The splits are not an object of lists of scene names.",
        'expected is {"train": ["scene", …], …}, and one such file',
    ),
    "DST-046": DatasetFault("A split names a scene that does not exist.", "are the splits of a larger dataset?"),
    "DST-047": DatasetFault("A scene is in two splits.", "a method trained on it would be tested on it"),
    "DST-048": DatasetFault(
        "Rows that belong to several scenes, copied to each, would take many times the size of the tables.",
        "are there many or long rows of log, map, category or sensor that belong to every scene?",
    ),
    "DST-049": DatasetFault(
        "A scene lies farther from the origin of `global` than a map of voxels reaches.",
        "are poses in UTM or ECEF? subtract the same whole metres from the translations of all",
    ),
    "DST-050": DatasetFault("The file of a row of sample_data is missing.", "was the dataset unpacked completely?"),
    "DST-051": DatasetFault(
        "A sweep does not consist of rows of five float32.",
        "x y z intensity ring; is it cut off, or are there four columns?",
    ),
    "DST-052": DatasetFault(
        "A sweep has points that are NaN or infinite.", "leave out returns without range before writing"
    ),
    "DST-053": DatasetFault("An image is neither JPEG nor PNG.", "is it an empty file, or a pointer of Git LFS?"),
    "DST-054": DatasetFault("An image ends before its end marker.", "was the copy cut off?"),
    "DST-055": DatasetFault("An image has another size than its row says.", "was it scaled without its intrinsics?"),
    "DST-056": DatasetFault(
        "A radar scan is not a binary PCD with the fields that are needed.",
        "x y z rcs vx_comp vy_comp, as nuScenes writes them",
    ),
    "DST-060": DatasetFault(
        "A frame of a labelled scene has no labels.",
        "gts/<scene>/<frame token>/labels.npz; was the dataset unpacked completely?",
    ),
    "DST-061": DatasetFault("A label file is not an npz file.", "was the copy cut off?"),
    "DST-062": DatasetFault(
        "Labels lack the array of classes.",
        "`semantics` in the paper's and Occ3D's layout, `label` in the release's; was another --layout stated?",
    ),
    "DST-063": DatasetFault(
        "Labels are of another grid than stated, or than the first labels.",
        "was another --grid stated, or are labels of two sets mixed?",
    ),
    "DST-064": DatasetFault("Labels are of another dtype or order.", "uint8 in C order"),
    "DST-065": DatasetFault(
        "Labels are larger than a grid, compressed or decompressed.", "is it a zip bomb, or a grid of floats?"
    ),
    "DST-066": DatasetFault(
        "Labels have values whose meaning is not given.",
        "give it with --classes; a set of 18 numbers is Occ3D's, whose 17 is free",
    ),
    "DST-067": DatasetFault(
        "A mask is not a uint8 grid of the labels' shape.", "is it a mask of pixels, or of another grid?"
    ),
    "DST-068": DatasetFault("A mask has other values than 0 and 1.", "is it 255 where it is true?"),
    "DST-069": DatasetFault(
        "annotations.json places labels elsewhere than at gts/<scene>/<frame token>/labels.npz.",
        "is it the annotations.json of another dataset?",
    ),
    "DST-070": DatasetFault(
        "The class map is not valid.", "`name: my-set` and `classes: {0: free, 11: T, 12: P, 13: N, 255: unobserved}`"
    ),
    "DST-071": DatasetFault(
        "The labels of a scene are free everywhere in all frames.",
        "does --classes call every class free, or are the labels of a test set blanked?",
    ),
    "DST-072": DatasetFault(
        "The labels of a scene occupy more voxels of a part of its map than any surface has.",
        "do the poses climb without end, or does --classes map free space to an occupied class?",
    ),
    "DST-073": DatasetFault(
        "Sweeps, labels and tables do not fit together: the returns of frames lie in no occupied voxels.",
        "state the grid with --grid; quaternions are w x y z",
    ),
    "DST-074": DatasetFault(
        "The returns of a frame lie in the labels of another frame.",
        "were frames or scenes mixed up, or numbered from another start, when labels or sweeps were written?",
    ),
}


class DatasetFaultError(StoneError):
    """A published dataset has the fault `code` of `DATASET_FAULTS`.

    What a sandboxed process raised has its sentence alone, in which the other rows are counted already.
    """

    rows = 1

    def __init__(self, code: str, place: DatasetPlace, what: str, likely: str = "") -> None:
        """`likely` is the mistake, if the value itself shows it; then `rows` of one file that have it are one fault."""
        super().__init__(f"{place}: {what} ({likely or DATASET_FAULTS[code].likely})")
        self.code, self.place, self.likely = code, place, likely

    def __str__(self) -> str:
        others = f"; {self.rows - 1} more rows of this file have it" if self.rows > 1 else ""
        return f"{super().__str__()}{others}"

    def as_record(self) -> dict[str, object]:
        return {"code": self.code, **asdict(self.place), "message": str(self), "rows": self.rows}
