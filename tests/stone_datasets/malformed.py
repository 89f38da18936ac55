"""What can be wrong with a published dataset: of each kind one edit of a good one, and the code that refuses it."""

import json
import os
import struct
import zlib
from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZIP_LZMA, ZipFile

import numpy as np

from stone_base.label_grid import PAPER
from stone_files.npz import npz_bytes
from testing.worlds.published_datasets import LOGFILE, VERSION
from tests.stone_datasets.conftest import GOOD, Edit, Rows, reannotated, rewritten

# (code, what is edited)
Kind = tuple[str, Edit]
NAN, INFINITE = float("nan"), float("inf")
GRID = np.zeros(PAPER.shape, np.uint8)
LABELS = f"gts/field-0000/{GOOD.tokens(0)[1]}/labels.npz"
SWEEP = GOOD.filename("LIDAR_TOP", GOOD.stamp_us(0, 0))
PICTURE = GOOD.filename("CAM_FRONT", GOOD.datum_us(0, 0, "CAM_FRONT"))
SCAN = GOOD.filename("RADAR_FRONT", GOOD.datum_us(0, 0, "RADAR_FRONT"))
SMALL_PNG = bytes.fromhex("89504e470d0a1a0a") + b"".join(
    struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
    for kind, body in (
        (b"IHDR", struct.pack(">2I5B", 2, 2, 8, 0, 0, 0, 0)),
        (b"IDAT", zlib.compress(bytes(6))),
        (b"IEND", b""),
    )
)


def table(name: str, change: Callable[[Rows], object]) -> Edit:
    return lambda folder: rewritten(folder, name, change)


def row(of: str, number: int, **values: Any) -> Edit:
    """Other values in the row of this number, counted from 0."""
    return table(of, lambda rows: rows[number].update(values))


def without(name: str, number: int, key: str) -> Edit:
    return table(name, lambda rows: rows[number].pop(key))


def text(name: str, content: str | bytes) -> Edit:
    """A file with this content."""
    as_bytes = content.encode() if isinstance(content, str) else content

    def write(folder: Path) -> None:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(as_bytes)

    return write


def gone(name: str) -> Edit:
    return lambda folder: (folder / name).unlink()


def cut(name: str, share: float) -> Edit:
    def shorten(folder: Path) -> None:
        content = (folder / name).read_bytes()
        (folder / name).write_bytes(content[: int(len(content) * share)])

    return shorten


def npz(**arrays: np.ndarray[Any, Any]) -> Edit:
    return text(LABELS, npz_bytes(arrays))


def linked(name: str, to: str | None = None) -> Edit:
    """The file is a link: out of the dataset, or to another of it."""

    def link(folder: Path) -> None:
        outside = folder.parent / "outside"
        outside.write_bytes((folder / name).read_bytes())
        (folder / name).unlink()
        os.symlink(outside if to is None else folder / to, folder / name)

    return link


def moved(folder: Path) -> None:
    """A folder of samples that is a link out of the dataset."""
    (folder / "samples/LIDAR_TOP").rename(folder.parent / "LIDAR_TOP")
    os.symlink(folder.parent / "LIDAR_TOP", folder / "samples/LIDAR_TOP")


def splits(content: object) -> Edit:
    return text("splits.json", json.dumps(content))


def circled(rows: Rows) -> None:
    rows[0]["prev"], rows[2]["next"] = rows[2]["token"], rows[0]["token"]


def split_chain(rows: Rows) -> None:
    """Two chains in one scene."""
    rows[0]["next"] = rows[1]["prev"] = ""


def blocks(content: bytes, mode: int) -> bytes:
    """Deflated by itself, so that such may follow each other."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    return packer.compress(content) + packer.flush(mode)


def bomb() -> bytes:
    """A npy whose data goes on for a gibibyte, in a megabyte: zeros that were deflated once, 64 times."""
    head = BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "|u1", "fortran_order": False, "shape": PAPER.shape})
    packed = blocks(head.getvalue(), zlib.Z_FULL_FLUSH) + blocks(bytes(1 << 24), zlib.Z_FULL_FLUSH) * 64
    packed += blocks(b"", zlib.Z_FINISH)
    local = struct.pack("<4s5H3I2H", b"PK\3\4", 20, 0, 8, 0, 33, 0, len(packed), 1 << 21, 13, 0) + b"semantics.npy"
    central = struct.pack("<4s6H3I5H2I", b"PK\1\2", 20, 20, 0, 8, 0, 33, 0, len(packed), 1 << 21, 13, *[0] * 6)
    end = struct.pack("<4s4H2IH", b"PK\5\6", 0, 0, 1, 1, len(central) + 13, len(local) + len(packed), 0)
    return local + packed + central + b"semantics.npy" + end


def packed(method: int, content: bytes = b"none") -> bytes:
    file = BytesIO()
    with ZipFile(file, "w", method) as archive:
        archive.writestr("semantics.npy", content)
    return file.getvalue()


S, D, P, C = "sample", "sample_data", "ego_pose", "calibrated_sensor"
KINDS: Mapping[str, Kind] = {
    "no tables": ("DST-001", lambda folder: (folder / VERSION).rename(folder / "tables")),
    "two versions": ("DST-002", lambda folder: (folder / "v1.0-mini").mkdir()),
    "a path above": ("DST-004", row(D, 0, filename="../../etc/passwd")),
    "an absolute path": ("DST-004", row(D, 4, filename="/etc/passwd")),
    "a link outside": ("DST-004", linked(SWEEP)),
    "a folder that is a link outside": ("DST-004", moved),
    "a missing table": ("DST-010", gone(f"{VERSION}/ego_pose.json")),
    "an empty table": ("DST-011", text(f"{VERSION}/sample.json", "")),
    "a table cut off": ("DST-011", cut(f"{VERSION}/sample_data.json", 0.7)),
    "a comma too many": ("DST-011", text(f"{VERSION}/log.json", '[{"token": "a"},]')),
    "rows without a comma": ("DST-011", text(f"{VERSION}/log.json", '[{"token": "a"} {"token": "b"}]')),
    "something after the end": ("DST-011", text(f"{VERSION}/log.json", "[] []")),
    "no UTF-8": ("DST-011", text(f"{VERSION}/log.json", b'[{"token": "\xff"}]')),
    "nesting": ("DST-011", text(f"{VERSION}/log.json", '[{"a":' + "[" * 100_000)),
    "a number of 5,000 digits": ("DST-011", text(f"{VERSION}/log.json", '[{"a":' + "1" * 5000 + "}]")),
    "an object of rows": ("DST-012", text(f"{VERSION}/sensor.json", '{"a": {}}')),
    "a row that is a list": ("DST-013", table("scene", lambda rows: rows.insert(1, [1]))),  # type: ignore[arg-type]
    "an endless row": ("DST-014", text(f"{VERSION}/log.json", '[{"a": "' + "x" * (1 << 22))),
    "a missing key": ("DST-015", without(D, 2, "ego_pose_token")),
    "a stamp of text": ("DST-016", row(S, 1, timestamp="yesterday")),
    "a flag that is a number": ("DST-016", row(D, 1, is_key_frame=1)),
    "a count that is a float": ("DST-016", row("scene", 0, nbr_samples=3.0)),
    "a translation of two": ("DST-016", row(P, 3, translation=[1, 2])),
    "a sensor of no known kind": ("DST-016", row("sensor", 0, modality="lidr")),
    "a frame's token in capitals": ("DST-017", row(S, 0, token="A" * 32)),
    "an empty token": ("DST-017", row("log", 0, token="")),
    "two sensors of one token": ("DST-018", table("sensor", lambda rows: rows.append(rows[0]))),
    "two frames of one token": ("DST-018", table(S, lambda rows: rows.append(rows[0]))),
    "two poses of one token": ("DST-018", table(P, lambda rows: rows.append(rows[3]))),
    "two data of one token": ("DST-018", table(D, lambda rows: rows.append(rows[0]))),
    "two categories of one token": ("DST-018", table("category", lambda rows: rows.append(rows[0]))),
    "a scene named as a path": ("DST-019", row("scene", 0, name="../up")),
    "a pose of NaN": ("DST-020", row(P, 5, translation=[0, NAN, 0])),
    "a mount at infinity": ("DST-020", row(C, 0, translation=[0, INFINITE, 0])),
    "a lens of NaN": ("DST-020", row(C, 1, camera_intrinsic=[[NAN, 0, 1], [0, 1, 1], [0, 0, 1]])),
    "coefficients of infinity": ("DST-020", row(C, 1, camera_distortion=[INFINITE] * 5)),
    "a rotation of 3 × 3": ("DST-021", row(C, 0, rotation=[[1, 0, 0], [0, 1, 0], [0, 0, 1]])),
    "a pose of 3 × 3": ("DST-021", row(P, 0, rotation=[[1, 0, 0], [0, 1, 0], [0, 0, 1]])),
    "a quaternion of length 2": ("DST-022", row(P, 2, rotation=[2, 0, 0, 0])),
    "a pose in millimetres": ("DST-023", row(P, 2, translation=[5e7, 0, 0])),
    "a mount in millimetres": ("DST-023", row(C, 0, translation=[0, 0, 1200])),
    "a matrix of 3 × 4": ("DST-024", row(C, 1, camera_intrinsic=[[1, 0, 1, 0]] * 3)),
    "a camera without a matrix": ("DST-024", row(C, 1, camera_intrinsic=[])),
    "a focal length of zero": ("DST-025", row(C, 1, camera_intrinsic=[[0, 0, 1], [0, 1, 1], [0, 0, 1]])),
    "a last row of zeros": ("DST-025", row(C, 1, camera_intrinsic=[[1, 0, 1], [0, 1, 1], [0, 0, 0]])),
    "an unknown lens": ("DST-026", row(C, 1, camera_model="omnidirectional")),
    "four coefficients": ("DST-026", row(C, 1, camera_distortion=[0.1] * 4)),
    "pictures of no size": ("DST-027", row(D, 1, width=0)),
    "pictures of two sizes": ("DST-027", row(D, 5, width=65)),
    "a stamp in seconds": ("DST-028", row(S, 0, timestamp=1_755_846_856)),
    "a stamp in nanoseconds": ("DST-028", row(D, 0, timestamp=1_755_846_856_000_000_000)),
    "a mount of no sensor": ("DST-030", row(C, 0, sensor_token="x")),
    "a scene of no log": ("DST-030", row("scene", 0, log_token="x")),
    "a frame of no scene": ("DST-030", row(S, 0, scene_token="x")),
    "a datum of no mount": ("DST-030", row(D, 0, calibrated_sensor_token="x")),
    "a datum of no frame": ("DST-030", row(D, 0, sample_token="x")),
    "a datum of no pose": ("DST-030", row(D, 7, ego_pose_token="x")),
    "a next of nothing": ("DST-030", row(S, 0, next="e" * 32)),
    "a prev of nothing": ("DST-030", row(D, 5, prev="e" * 32)),
    "two scenes of one name": ("DST-031", row("scene", 1, name="field-0000")),
    "a wrong first sample": ("DST-032", row("scene", 0, first_sample_token=GOOD.tokens(0)[1])),
    "a wrong last sample": ("DST-032", row("scene", 1, last_sample_token="x")),
    "a wrong number of samples": ("DST-033", row("scene", 0, nbr_samples=4)),
    "a chain that nothing returns": ("DST-034", row(S, 1, prev="")),
    "a chain into another scene": (
        "DST-034",
        table(S, lambda rows: (rows[2].update(next=rows[3]["token"]), rows[3].update(prev=rows[2]["token"]))),
    ),
    "a chain in a circle": ("DST-034", table(S, circled)),
    "two chains in a scene": ("DST-034", table(S, split_chain)),
    "a chain of data that is cut": ("DST-034", row(D, 4, next="")),
    "stamps that repeat": ("DST-035", row(S, 1, timestamp=GOOD.stamp_us(0, 0))),
    "stamps that fall": ("DST-035", row(S, 2, timestamp=GOOD.stamp_us(0, 0) - 1)),
    "a frame without a sweep": ("DST-036", row(D, 4, is_key_frame=False)),
    "two pictures of one camera": ("DST-037", row(D, 5, sample_token=GOOD.tokens(0)[0])),
    "a mount that changes": (
        "DST-038",
        table(D, lambda rows: rows[4].update(calibrated_sensor_token=rows[12]["calibrated_sensor_token"])),
    ),
    "a frame far from its sweep": (
        "DST-039",
        table(S, lambda rows: [one.update(timestamp=one["timestamp"] + 2_000_000) for one in rows[:3]]),
    ),
    "a file of another stamp": ("DST-040", row(D, 0, filename=SWEEP.replace("000.pcd", "001.pcd"))),
    "a file of another camera": ("DST-041", row(D, 1, filename=PICTURE.replace("FRONT", "BACK"))),
    "a file in no folder": ("DST-041", row(D, 0, filename="sweep.pcd.bin")),
    "one file twice": (
        "DST-042",
        table(
            D,
            lambda rows: (
                rows[0].update(filename="samples/LIDAR_TOP/a.bin"),
                rows[4].update(filename="samples/LIDAR_TOP/a.bin"),
            ),
        ),
    ),
    "splits that are a list": ("DST-045", splits(["field-0000"])),
    "a split that is a name": ("DST-045", splits({"train": "field-0000"})),
    "two files of splits": ("DST-045", text(f"{VERSION}/splits.json", "{}")),
    "a split of an unknown scene": ("DST-046", splits({"val": ["scene-0916"]})),
    "a scene in two splits": ("DST-047", splits({"train": ["field-0000"], "val": ["field-0000"]})),
    "a missing sweep": ("DST-050", gone(SWEEP)),
    "a link to nothing": ("DST-050", linked(SWEEP, "samples/nothing")),
    "a sweep cut off": ("DST-051", text(SWEEP, bytes(30))),
    "an empty sweep": ("DST-051", text(SWEEP, b"")),
    "a sweep of NaN": ("DST-052", text(SWEEP, np.array([0, 0, 0, 1, 1, NAN, 0, 0, 0, 0], "<f4").tobytes())),
    "a picture that is none": ("DST-053", text(PICTURE, "version https://git-lfs.github.com/spec/v1")),
    "a picture cut off": ("DST-054", cut(PICTURE, 0.8)),
    "a picture of another size": ("DST-055", text(PICTURE, SMALL_PNG)),
    "a scan that is none": ("DST-056", text(SCAN, b"# .PCD v0.7\nDATA ascii\n")),
    "missing labels": ("DST-060", gone(LABELS)),
    "labels that are no zip": ("DST-061", text(LABELS, b"none")),
    "labels cut off": ("DST-061", cut(LABELS, 0.5)),
    "labels packed by LZMA": ("DST-061", text(LABELS, packed(ZIP_LZMA))),
    "labels that are no array": ("DST-061", text(LABELS, packed(ZIP_DEFLATED))),
    "labels without semantics": ("DST-062", npz(occupancy=GRID)),
    "Occ3D's grid": ("DST-063", npz(semantics=np.zeros((200, 200, 16), np.uint8))),
    "labels of 64 bits": ("DST-064", npz(semantics=GRID.astype(np.int64))),
    "a zip bomb": ("DST-065", text(LABELS, bomb())),
    "labels of 17 classes": ("DST-066", npz(semantics=GRID + np.uint8(17))),
    "a mask of another grid": ("DST-067", npz(semantics=GRID, mask_lidar=GRID[:, :, :16])),
    "a mask of floats": ("DST-067", npz(semantics=GRID, mask_camera=GRID.astype(np.float32))),
    "a mask of 255": ("DST-068", npz(semantics=GRID, mask_lidar=GRID + np.uint8(255))),
}


def info(content: dict[str, Any], frame: int = 0) -> dict[str, Any]:
    found: dict[str, Any] = content["scene_infos"]["field-0000"][GOOD.tokens(0)[frame]]
    return found


def camera(content: dict[str, Any], frame: int = 0) -> dict[str, Any]:
    found: dict[str, Any] = next(iter(info(content, frame)["camera_sensor"].values()))
    return found


def annotated(change: Callable[[dict[str, Any]], object]) -> Edit:
    return lambda folder: reannotated(folder, change)


TAKEN = f"imgs/CAM_FRONT/{LOGFILE}__CAM_FRONT__{GOOD.datum_us(0, 0, 'CAM_FRONT')}.jpg"
ANNOTATED: Mapping[str, Kind] = {
    "annotations cut off": ("DST-011", cut("annotations.json", 0.5)),
    "annotations of a list": ("DST-011", text("annotations.json", "[]")),
    "annotations of nothing": ("DST-001", text("annotations.json", "{}")),
    "a scene as a path": ("DST-019", annotated(lambda c: c["scene_infos"].update({"../x": {}}))),
    "a frame without a pose": ("DST-015", annotated(lambda c: info(c).pop("ego_pose"))),
    "a frame that is text": ("DST-016", annotated(lambda c: c["scene_infos"]["field-0000"].update({"f" * 32: "x"}))),
    "a frame named as no token": ("DST-017", annotated(lambda c: c["scene_infos"]["field-0000"].update(x=info(c)))),
    "a frame in two scenes": (
        "DST-018",
        annotated(lambda c: c["scene_infos"]["field-0001"].update({GOOD.tokens(0)[0]: info(c) | {"gt_path": ""}})),
    ),
    "a camera's rotation of 3 × 3": (
        "DST-021",
        annotated(lambda c: camera(c)["extrinsic"].update(rotation=[[1, 0, 0]] * 3)),
    ),
    "an intrinsic of 3 × 4": ("DST-024", annotated(lambda c: camera(c).update(intrinsic=[[1, 0, 1, 0]] * 3))),
    "a camera that moves": (
        "DST-038",
        annotated(lambda c: camera(c, 1).update(extrinsic={"rotation": [1, 0, 0, 0], "translation": [0, 0, 0]})),
    ),
    "two pictures of a camera": ("DST-037", annotated(lambda c: info(c)["camera_sensor"].update(x=camera(c)))),
    "a chain that breaks": ("DST-034", annotated(lambda c: info(c, 1).update(prev=""))),
    "a picture above": ("DST-004", annotated(lambda c: camera(c).update(img_path="../x/y.jpg"))),
    "a missing picture": ("DST-050", gone(TAKEN)),
    "labels elsewhere": ("DST-069", annotated(lambda c: info(c).update(gt_path="gts/other/labels.npz"))),
    "a split of a scene that is not there": ("DST-046", annotated(lambda c: c.update(val_split=["x"]))),
    "a split of a number": ("DST-045", annotated(lambda c: c.update(val_split=3))),
    "labels of 17 numbers": ("DST-066", npz(semantics=GRID + np.uint8(17))),
}
