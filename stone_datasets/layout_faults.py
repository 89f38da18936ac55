"""What is refused of a dataset's JSON and of the values of its rows."""

from typing import ClassVar

from stone_datasets.faults import DatasetFaultError


class TooManyRowsError(DatasetFaultError):
    """A table has more rows than are read."""

    code: ClassVar[str] = "DST-005"
    likely: ClassVar[str] = "is it a table at all?"


class TableMissingError(DatasetFaultError):
    """A table is missing."""

    code: ClassVar[str] = "DST-010"
    likely: ClassVar[str] = "was the dataset unpacked completely?"


class TableNotJsonError(DatasetFaultError):
    """A table is not JSON."""

    code: ClassVar[str] = "DST-011"
    likely: ClassVar[str] = "was the download cut off?"


class TableNotArrayError(DatasetFaultError):
    """A table is JSON, but not a list of rows."""

    code: ClassVar[str] = "DST-012"
    likely: ClassVar[str] = "tables are `[{…}, …]`"


class RowNotObjectError(DatasetFaultError):
    """A row of a table is not an object."""

    code: ClassVar[str] = "DST-013"
    likely: ClassVar[str] = "tables are `[{…}, …]`"


class RowTooLongError(DatasetFaultError):
    """A row of a table is longer than any row can be."""

    code: ClassVar[str] = "DST-014"
    likely: ClassVar[str] = "is a quote or a bracket missing?"


class KeyMissingError(DatasetFaultError):
    """A row lacks a key that is needed."""

    code: ClassVar[str] = "DST-015"
    likely: ClassVar[str] = "was it written by another version of the tool?"


class WrongTypeError(DatasetFaultError):
    """A value is of another type than the schema says."""

    code: ClassVar[str] = "DST-016"
    likely: ClassVar[str] = "is a number written as text?"


class BadDatasetTokenError(DatasetFaultError):
    """A token is invalid: a frame token is 32 hex digits, any other 1 to 128 characters."""

    code: ClassVar[str] = "DST-017"
    likely: ClassVar[str] = "frame tokens name the folders of labels and the files of submissions"


class DuplicateTokenError(DatasetFaultError):
    """Two rows of a table have one token."""

    code: ClassVar[str] = "DST-018"
    likely: ClassVar[str] = "were two datasets joined, or was one row written twice?"


class BadSceneNameError(DatasetFaultError):
    """The name of a scene cannot name a sequence."""

    code: ClassVar[str] = "DST-019"
    likely: ClassVar[str] = "1 to 100 letters, digits, dots, dashes and underscores, the first a letter or digit"


class NotFiniteValueError(DatasetFaultError):
    """A number is NaN or infinite."""

    code: ClassVar[str] = "DST-020"
    likely: ClassVar[str] = "did the localisation fail here?"


class RotationMatrixError(DatasetFaultError):
    """A rotation is a 3 × 3 matrix."""

    code: ClassVar[str] = "DST-021"
    likely: ClassVar[str] = "the schema wants a quaternion w x y z"


class NotUnitQuaternionError(DatasetFaultError):
    """A quaternion is not of unit length."""

    code: ClassVar[str] = "DST-022"
    likely: ClassVar[str] = "the order is w x y z; was it averaged without normalising?"


class AbsurdTranslationError(DatasetFaultError):
    """A translation is beyond any plausible distance."""

    code: ClassVar[str] = "DST-023"
    likely: ClassVar[str] = "are they metres, and not millimetres or degrees?"


class IntrinsicsShapeError(DatasetFaultError):
    """A camera's matrix is not 3 × 3."""

    code: ClassVar[str] = "DST-024"
    likely: ClassVar[str] = "is it the 3 × 4 projection, or empty as a LiDAR's?"


class SingularIntrinsicsError(DatasetFaultError):
    """A camera's matrix is singular, or not that of a pinhole camera."""

    code: ClassVar[str] = "DST-025"
    likely: ClassVar[str] = "is it [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels?"


class UnknownLensError(DatasetFaultError):
    """A camera's model is not known, or has another number of coefficients."""

    code: ClassVar[str] = "DST-026"
    likely: ClassVar[str] = "pinhole 0, plumb_bob 5, rational_polynomial 8, equidistant 4"


class CameraSizeError(DatasetFaultError):
    """The tables do not give one size for the images of a camera."""

    code: ClassVar[str] = "DST-027"
    likely: ClassVar[str] = "`width` and `height` of sample_data are pixels, of one calibration always the same"


class DatasetStampError(DatasetFaultError):
    """A stamp is not a number of microseconds since 1970."""

    code: ClassVar[str] = "DST-028"
    likely: ClassVar[str] = "seconds, milliseconds or nanoseconds?"
