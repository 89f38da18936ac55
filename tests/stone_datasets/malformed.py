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

from stone.labels.grid import GRID_SHAPE
from stone_files.npz import npz_bytes
from testing.worlds.published_datasets import LOGFILE, VERSION
from tests.stone_datasets.conftest import GOOD, Edit, Rows, reannotated, rewritten

# (code, what is edited, what the message also says)
Kind = tuple[str, Edit, str]
NAN, INFINITE = float("nan"), float("inf")
GRID = np.zeros(GRID_SHAPE, np.uint8)
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
    np.lib.format.write_array_header_1_0(head, {"descr": "|u1", "fortran_order": False, "shape": GRID_SHAPE})
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
    "no tables": ("DST-001", lambda folder: (folder / VERSION).rename(folder / "tables"), "v1.0-"),
    "two versions": ("DST-002", lambda folder: (folder / "v1.0-mini").mkdir(), "v1.0-mini"),
    "a path above": ("DST-004", row(D, 0, filename="../../etc/passwd"), "sample_data.json row 1"),
    "an absolute path": ("DST-004", row(D, 4, filename="/etc/passwd"), "row 5"),
    "a link outside": ("DST-004", linked(SWEEP), SWEEP),
    "a folder that is a link outside": ("DST-004", moved, "samples/LIDAR_TOP"),
    "a missing table": ("DST-010", gone(f"{VERSION}/ego_pose.json"), "ego_pose.json"),
    "an empty table": ("DST-011", text(f"{VERSION}/sample.json", ""), "it is empty"),
    "a table cut off": ("DST-011", cut(f"{VERSION}/sample_data.json", 0.7), "sample_data.json"),
    "a comma too many": ("DST-011", text(f"{VERSION}/log.json", '[{"token": "a"},]'), "log.json"),
    "rows without a comma": ("DST-011", text(f"{VERSION}/log.json", '[{"token": "a"} {"token": "b"}]'), "','"),
    "something after the end": ("DST-011", text(f"{VERSION}/log.json", "[] []"), "follows the end"),
    "no UTF-8": ("DST-011", text(f"{VERSION}/log.json", b'[{"token": "\xff"}]'), "not UTF-8"),
    "nesting": ("DST-011", text(f"{VERSION}/log.json", '[{"a":' + "[" * 100_000), "nested too deeply"),
    "a number of 5,000 digits": (
        "DST-011",
        text(f"{VERSION}/log.json", '[{"a":' + "1" * 5000 + "}]"),
        "log.json row 1",
    ),
    "an object of rows": ("DST-012", text(f"{VERSION}/sensor.json", '{"a": {}}'), "begins with '{'"),
    "a row that is a list": ("DST-013", table("scene", lambda rows: rows.insert(1, [1])), "scene.json row 2"),  # type: ignore[arg-type]
    "an endless row": ("DST-014", text(f"{VERSION}/log.json", '[{"a": "' + "x" * (1 << 22)), "1048576"),
    "a missing key": ("DST-015", without(D, 2, "ego_pose_token"), "row 3 (token"),
    "a stamp of text": ("DST-016", row(S, 1, timestamp="yesterday"), "'yesterday'"),
    "a flag that is a number": ("DST-016", row(D, 1, is_key_frame=1), "true or false"),
    "a count that is a float": ("DST-016", row("scene", 0, nbr_samples=3.0), "3.0"),
    "a translation of two": ("DST-016", row(P, 3, translation=[1, 2]), "3 numbers"),
    "a sensor of no known kind": ("DST-016", row("sensor", 0, modality="lidr"), "'lidr'"),
    "a frame's token in capitals": ("DST-017", row(S, 0, token="A" * 32), "'AAAA"),
    "an empty token": ("DST-017", row("log", 0, token=""), "log.json row 1"),
    "two sensors of one token": ("DST-018", table("sensor", lambda rows: rows.append(rows[0])), "sensor.json row 5"),
    "two frames of one token": ("DST-018", table(S, lambda rows: rows.append(rows[0])), "row 7 (token"),
    "two poses of one token": ("DST-018", table(P, lambda rows: rows.append(rows[3])), "row 25: row 4"),
    "two data of one token": ("DST-018", table(D, lambda rows: rows.append(rows[0])), "row 1 has the same token"),
    "two categories of one token": ("DST-018", table("category", lambda rows: rows.append(rows[0])), "category.json"),
    "a scene named as a path": ("DST-019", row("scene", 0, name="../up"), "'../up'"),
    "a pose of NaN": ("DST-020", row(P, 5, translation=[0, NAN, 0]), "ego_pose.json row 6"),
    "a mount at infinity": ("DST-020", row(C, 0, translation=[0, INFINITE, 0]), "calibrated_sensor.json row 1"),
    "a lens of NaN": ("DST-020", row(C, 1, camera_intrinsic=[[NAN, 0, 1], [0, 1, 1], [0, 0, 1]]), "camera_intrinsic"),
    "coefficients of infinity": ("DST-020", row(C, 1, camera_distortion=[INFINITE] * 5), "camera_distortion"),
    "a rotation of 3 × 3": ("DST-021", row(C, 0, rotation=[[1, 0, 0], [0, 1, 0], [0, 0, 1]]), "quaternion"),
    "a pose of 3 × 3": ("DST-021", row(P, 0, rotation=[[1, 0, 0], [0, 1, 0], [0, 0, 1]]), "ego_pose.json row 1"),
    "a quaternion of length 2": ("DST-022", row(P, 2, rotation=[2, 0, 0, 0]), "length 2"),
    "a pose in millimetres": ("DST-023", row(P, 2, translation=[5e7, 0, 0]), "1e+07 m"),
    "a mount in millimetres": ("DST-023", row(C, 0, translation=[0, 0, 1200]), "100 m"),
    "a matrix of 3 × 4": ("DST-024", row(C, 1, camera_intrinsic=[[1, 0, 1, 0]] * 3), "calibrated_sensor.json row 2"),
    "a camera without a matrix": ("DST-024", row(C, 1, camera_intrinsic=[]), "3 × 4"),
    "a focal length of zero": ("DST-025", row(C, 1, camera_intrinsic=[[0, 0, 1], [0, 1, 1], [0, 0, 1]]), "fx"),
    "a last row of zeros": ("DST-025", row(C, 1, camera_intrinsic=[[1, 0, 1], [0, 1, 1], [0, 0, 0]]), "fx"),
    "an unknown lens": ("DST-026", row(C, 1, camera_model="omnidirectional"), "'omnidirectional'"),
    "four coefficients": ("DST-026", row(C, 1, camera_distortion=[0.1] * 4), "plumb_bob"),
    "pictures of no size": ("DST-027", row(D, 1, width=0), "width and height are (0, 48)"),
    "pictures of two sizes": ("DST-027", row(D, 5, width=65), "earlier ones are (64, 48)"),
    "a stamp in seconds": ("DST-028", row(S, 0, timestamp=1_755_846_856), "nanoseconds?"),
    "a stamp in nanoseconds": ("DST-028", row(D, 0, timestamp=1_755_846_856_000_000_000), "sample_data.json row 1"),
    "a mount of no sensor": ("DST-030", row(C, 0, sensor_token="x"), "sensor_token 'x' is not a token of sensor"),
    "a scene of no log": ("DST-030", row("scene", 0, log_token="x"), "scene.json row 1"),
    "a frame of no scene": ("DST-030", row(S, 0, scene_token="x"), "is not a token of scene"),
    "a datum of no mount": ("DST-030", row(D, 0, calibrated_sensor_token="x"), "calibrated_sensor"),
    "a datum of no frame": ("DST-030", row(D, 0, sample_token="x"), "sample_token is not a token of sample"),
    "a datum of no pose": ("DST-030", row(D, 7, ego_pose_token="x"), "row 8"),
    "a next of nothing": ("DST-030", row(S, 0, next="e" * 32), "sample.json row 1"),
    "a prev of nothing": ("DST-030", row(D, 5, prev="e" * 32), "sample_data.json row 6"),
    "two scenes of one name": ("DST-031", row("scene", 1, name="field-0000"), "scene.json row 2"),
    "a wrong first sample": ("DST-032", row("scene", 0, first_sample_token=GOOD.tokens(0)[1]), "first"),
    "a wrong last sample": ("DST-032", row("scene", 1, last_sample_token="x"), "scene.json row 2"),
    "a wrong number of samples": ("DST-033", row("scene", 0, nbr_samples=4), "nbr_samples is 4, its samples are 3"),
    "a chain that nothing returns": ("DST-034", row(S, 1, prev=""), "does not point back to it"),
    "a chain into another scene": (
        "DST-034",
        table(S, lambda rows: (rows[2].update(next=rows[3]["token"]), rows[3].update(prev=rows[2]["token"]))),
        "another scene",
    ),
    "a chain in a circle": ("DST-034", table(S, circled), "cycle"),
    "two chains in a scene": ("DST-034", table(S, split_chain), "sample.json row 2"),
    "a chain of data that is cut": ("DST-034", row(D, 4, next=""), "sample_data.json"),
    "stamps that repeat": ("DST-035", row(S, 1, timestamp=GOOD.stamp_us(0, 0)), "sample.json row 1"),
    "stamps that fall": ("DST-035", row(S, 2, timestamp=GOOD.stamp_us(0, 0) - 1), "sample.json row 2"),
    "a frame without a sweep": ("DST-036", row(D, 4, is_key_frame=False), GOOD.tokens(0)[1]),
    "two pictures of one camera": ("DST-037", row(D, 5, sample_token=GOOD.tokens(0)[0]), "CAM_FRONT"),
    "a mount that changes": (
        "DST-038",
        table(D, lambda rows: rows[4].update(calibrated_sensor_token=rows[12]["calibrated_sensor_token"])),
        "sample_data.json row 5",
    ),
    "a frame far from its sweep": (
        "DST-039",
        table(S, lambda rows: [one.update(timestamp=one["timestamp"] + 2_000_000) for one in rows[:3]]),
        "-2.0 s",
    ),
    "a file of another stamp": (
        "DST-040",
        row(D, 0, filename=SWEEP.replace("000.pcd", "001.pcd")),
        "timestamp 1755846856000000",
    ),
    "a file of another camera": ("DST-041", row(D, 1, filename=PICTURE.replace("FRONT", "BACK")), "CAM_BACK"),
    "a file in no folder": ("DST-041", row(D, 0, filename="sweep.pcd.bin"), "'sweep.pcd.bin'"),
    "one file twice": (
        "DST-042",
        table(
            D,
            lambda rows: (
                rows[0].update(filename="samples/LIDAR_TOP/a.bin"),
                rows[4].update(filename="samples/LIDAR_TOP/a.bin"),
            ),
        ),
        "row 5: row 1",
    ),
    "splits that are a list": ("DST-045", splits(["field-0000"]), "splits.json"),
    "a split that is a name": ("DST-045", splits({"train": "field-0000"}), "'train' is 'field-0000'"),
    "two files of splits": ("DST-045", text(f"{VERSION}/splits.json", "{}"), "there is v1.0-trainval/splits.json too"),
    "a split of an unknown scene": ("DST-046", splits({"val": ["scene-0916"]}), "'scene-0916'"),
    "a scene in two splits": (
        "DST-047",
        splits({"train": ["field-0000"], "val": ["field-0000"]}),
        "'train' and in 'val'",
    ),
    "a missing sweep": ("DST-050", gone(SWEEP), f"{SWEEP} is missing"),
    "a link to nothing": ("DST-050", linked(SWEEP, "samples/nothing"), SWEEP),
    "a sweep cut off": ("DST-051", text(SWEEP, bytes(30)), "30 bytes"),
    "an empty sweep": ("DST-051", text(SWEEP, b""), "0 bytes"),
    "a sweep of NaN": (
        "DST-052",
        text(SWEEP, np.array([0, 0, 0, 1, 1, NAN, 0, 0, 0, 0], "<f4").tobytes()),
        "1 of 2 points, the first is 1",
    ),
    "a picture that is none": (
        "DST-053",
        text(PICTURE, "version https://git-lfs.github.com/spec/v1"),
        "sample_data.json row 2",
    ),
    "a picture cut off": ("DST-054", cut(PICTURE, 0.8), "no end marker"),
    "a picture of another size": ("DST-055", text(PICTURE, SMALL_PNG), "2 × 2 pixels, its row says 64 × 48"),
    "a scan that is none": ("DST-056", text(SCAN, b"# .PCD v0.7\nDATA ascii\n"), "not a binary PCD"),
    "missing labels": ("DST-060", gone(LABELS), LABELS),
    "labels that are no zip": ("DST-061", text(LABELS, b"none"), LABELS),
    "labels cut off": ("DST-061", cut(LABELS, 0.5), LABELS),
    "labels packed by LZMA": ("DST-061", text(LABELS, packed(ZIP_LZMA)), "by a method that npz does not use"),
    "labels that are no array": ("DST-061", text(LABELS, packed(ZIP_DEFLATED)), "not an npy"),
    "labels without semantics": ("DST-062", npz(occupancy=GRID), "it has no semantics, but occupancy"),
    "Occ3D's grid": ("DST-063", npz(semantics=np.zeros((200, 200, 16), np.uint8)), "(200, 200, 16)"),
    "labels of 64 bits": ("DST-064", npz(semantics=GRID.astype(np.int64)), "int64"),
    "a zip bomb": ("DST-065", text(LABELS, bomb()), "continues after"),
    "labels of 17 classes": ("DST-066", npz(semantics=GRID + np.uint8(17)), "semantics has 17, which 'stone'"),
    "a mask of another grid": ("DST-067", npz(semantics=GRID, mask_lidar=GRID[:, :, :16]), "mask_lidar"),
    "a mask of floats": ("DST-067", npz(semantics=GRID, mask_camera=GRID.astype(np.float32)), "float32"),
    "a mask of 255": ("DST-068", npz(semantics=GRID, mask_lidar=GRID + np.uint8(255)), "mask_lidar has 255"),
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
    "annotations cut off": ("DST-011", cut("annotations.json", 0.5), "annotations.json"),
    "annotations of a list": ("DST-011", text("annotations.json", "[]"), "'{' is expected"),
    "annotations of nothing": ("DST-001", text("annotations.json", "{}"), "no scenes"),
    "a scene as a path": ("DST-019", annotated(lambda content: content["scene_infos"].update({"../x": {}})), "'../x'"),
    "a frame without a pose": ("DST-015", annotated(lambda content: info(content).pop("ego_pose")), "field-0000 row 1"),
    "a frame that is text": (
        "DST-016",
        annotated(lambda content: content["scene_infos"]["field-0000"].update({"f" * 32: "x"})),
        "an object",
    ),
    "a frame named as no token": (
        "DST-017",
        annotated(lambda content: content["scene_infos"]["field-0000"].update(x=info(content))),
        "'x'",
    ),
    "a frame in two scenes": (
        "DST-018",
        annotated(
            lambda content: content["scene_infos"]["field-0001"].update(
                {GOOD.tokens(0)[0]: info(content) | {"gt_path": ""}}
            )
        ),
        "field-0001",
    ),
    "a camera's rotation of 3 × 3": (
        "DST-021",
        annotated(lambda content: camera(content)["extrinsic"].update(rotation=[[1, 0, 0]] * 3)),
        "quaternion",
    ),
    "an intrinsic of 3 × 4": (
        "DST-024",
        annotated(lambda content: camera(content).update(intrinsic=[[1, 0, 1, 0]] * 3)),
        "intrinsic",
    ),
    "a camera that moves": (
        "DST-038",
        annotated(
            lambda content: camera(content, 1).update(extrinsic={"rotation": [1, 0, 0, 0], "translation": [0, 0, 0]})
        ),
        "CAM_FRONT",
    ),
    "two pictures of a camera": (
        "DST-037",
        annotated(lambda content: info(content)["camera_sensor"].update(x=camera(content))),
        "two pictures",
    ),
    "a chain that breaks": ("DST-034", annotated(lambda content: info(content, 1).update(prev="")), "point back"),
    "a picture above": (
        "DST-004",
        annotated(lambda content: camera(content).update(img_path="../x/y.jpg")),
        "img_path",
    ),
    "a missing picture": ("DST-050", gone(TAKEN), TAKEN),
    "labels elsewhere": (
        "DST-069",
        annotated(lambda content: info(content).update(gt_path="gts/other/labels.npz")),
        "gts/other",
    ),
    "a split of a scene that is not there": (
        "DST-046",
        annotated(lambda content: content.update(val_split=["x"])),
        "'x'",
    ),
    "a split of a number": ("DST-045", annotated(lambda content: content.update(val_split=3)), "val_split"),
    "labels of 17 numbers": ("DST-066", npz(semantics=GRID + np.uint8(17)), "--classes"),
}
