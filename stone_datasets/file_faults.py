"""What is refused of the files of a dataset: sweeps, pictures, scans, labels, and the file of classes."""

from typing import ClassVar

from stone_datasets.faults import DatasetFaultError


class SampleMissingError(DatasetFaultError):
    """The file of a row of sample_data is missing."""

    code: ClassVar[str] = "DST-050"
    likely: ClassVar[str] = "was the dataset unpacked completely?"


class SweepSizeError(DatasetFaultError):
    """A sweep does not consist of rows of five float32."""

    code: ClassVar[str] = "DST-051"
    likely: ClassVar[str] = "x y z intensity ring; is it cut off, or are there four columns?"


class SweepNotFiniteError(DatasetFaultError):
    """A sweep has points that are NaN or infinite."""

    code: ClassVar[str] = "DST-052"
    likely: ClassVar[str] = "leave out returns without range before writing"


class NotAPictureError(DatasetFaultError):
    """An image is neither JPEG nor PNG."""

    code: ClassVar[str] = "DST-053"
    likely: ClassVar[str] = "is it an empty file, or a pointer of Git LFS?"


class PictureCutOffError(DatasetFaultError):
    """An image ends before its end marker."""

    code: ClassVar[str] = "DST-054"
    likely: ClassVar[str] = "was the copy cut off?"


class PictureSizeError(DatasetFaultError):
    """An image has another size than its row says."""

    code: ClassVar[str] = "DST-055"
    likely: ClassVar[str] = "was it scaled without its intrinsics?"


class BadScanError(DatasetFaultError):
    """A radar scan is not a binary PCD with the fields that are needed."""

    code: ClassVar[str] = "DST-056"
    likely: ClassVar[str] = "x y z rcs vx_comp vy_comp, as nuScenes writes them"


class LabelsMissingError(DatasetFaultError):
    """A frame of a labelled scene has no labels."""

    code: ClassVar[str] = "DST-060"
    likely: ClassVar[str] = "gts/<scene>/<frame token>/labels.npz; was the dataset unpacked completely?"


class LabelsNotNpzError(DatasetFaultError):
    """A label file is not an npz file."""

    code: ClassVar[str] = "DST-061"
    likely: ClassVar[str] = "was the copy cut off?"


class LabelKeyError(DatasetFaultError):
    """Labels lack an array."""

    code: ClassVar[str] = "DST-062"
    likely: ClassVar[str] = "labels.npz has semantics, mask_lidar and mask_camera"


class LabelShapeError(DatasetFaultError):
    """Labels are of another grid."""

    code: ClassVar[str] = "DST-063"
    likely: ClassVar[str] = (
        "this platform's is 256 × 256 × 32 voxels of 0.2 m; Occ3D-nuScenes has 200 × 200 × 16 of 0.4 m, "
        "which is another grid"
    )


class LabelTypeError(DatasetFaultError):
    """Labels are of another dtype or order."""

    code: ClassVar[str] = "DST-064"
    likely: ClassVar[str] = "uint8 in C order"


class LabelsTooLargeError(DatasetFaultError):
    """Labels are larger than a grid, compressed or decompressed."""

    code: ClassVar[str] = "DST-065"
    likely: ClassVar[str] = "is it a zip bomb, or a grid of floats?"


class UnknownLabelsError(DatasetFaultError):
    """Labels have values whose meaning is not given."""

    code: ClassVar[str] = "DST-066"
    likely: ClassVar[str] = "give it with --classes; a set of 18 numbers is Occ3D's, whose 17 is free"


class MaskShapeError(DatasetFaultError):
    """A mask is not a uint8 grid of the labels' shape."""

    code: ClassVar[str] = "DST-067"
    likely: ClassVar[str] = "is it a mask of pixels, or of another grid?"


class MaskValueError(DatasetFaultError):
    """A mask has other values than 0 and 1."""

    code: ClassVar[str] = "DST-068"
    likely: ClassVar[str] = "is it 255 where it is true?"


class LabelPathError(DatasetFaultError):
    """annotations.json places labels elsewhere than at gts/<scene>/<frame token>/labels.npz."""

    code: ClassVar[str] = "DST-069"
    likely: ClassVar[str] = "is it the annotations.json of another dataset?"


class BadClassMapError(DatasetFaultError):
    """The class map is not valid."""

    code: ClassVar[str] = "DST-070"
    likely: ClassVar[str] = "`name: my-set` and `classes: {0: free, 11: T, 12: P, 13: N, 255: unobserved}`"


class NothingOccupiedError(DatasetFaultError):
    """The labels of a scene are free everywhere in all frames."""

    code: ClassVar[str] = "DST-071"
    likely: ClassVar[str] = "does --classes call every class free, or are the labels of a test set blanked?"


class MapTooDenseError(DatasetFaultError):
    """The labels of a scene occupy more voxels of a part of its map than any surface has."""

    code: ClassVar[str] = "DST-072"
    likely: ClassVar[str] = "do the poses climb without end, or does --classes map free space to an occupied class?"
