"""Makes the golden vectors of the metric anew: `python -m tests.golden_vectors`.

**Conventions.** Grids come from integer arithmetic alone, files from numpy and zipfile, expectations from
`tests/slow_metric.py`; nothing of the platform takes part. The same files every time, but for the zlib of the machine.
"""

import io
import json
import zipfile
from hashlib import md5
from pathlib import Path
from typing import Any

import numpy as np

from tests.slow_metric import Counts, added, added_columns, slow_counts, slow_extras, slow_ratios, slow_tolerant

FOLDER = Path(__file__).resolve().parents[1] / "services" / "domain" / "benchmarks" / "golden"
SHAPE = (256, 256, 32)
METRICS = ("stone-iou-2", "stone-iou-1", "stone-iou-occupied-2", "stone-iou-occupied-1")
MASKS = ("all", "lidar", "camera")
SEQUENCES = {"golden-mixed": 2, "golden-absent": 1, "golden-free": 1}
EPOCH = (1980, 1, 1, 0, 0, 0)


def token_of(sequence: str, index: int) -> str:
    return md5(f"{sequence}/{index}".encode()).hexdigest()


TOKENS = {name: [token_of(name, index) for index in range(count)] for name, count in SEQUENCES.items()}


def mixed(index: int) -> tuple[Any, Any]:
    """A stepped field in strips of all classes with walls on it, and the same shifted, mislabelled and with holes."""
    x, y, z = np.ogrid[:256, :256, :32]
    ground = 8 + (x // 32 + index) % 3 - (y // 64) % 2
    strip = (y // 24 + x // 40 + index) % 3 + 1
    truth = np.where((z >= ground - 1) & (z <= ground), strip, 0)
    walls = ((x // 8) % 8 == 3) & ((y // 12) % 6 == index + 1) & (z > ground) & (z < ground + 6)
    truth = np.where(walls, 3, truth)
    prediction = np.roll(truth, (1 + index, -2, 0), axis=(0, 1, 2))
    prediction = np.where((x // 48 + y // 48) % 5 == 4, prediction % 3 + (prediction > 0), prediction)
    prediction = np.where((x // 16 + y // 16) % 7 == index, 0, prediction)
    prediction[0, 0, 0] = prediction[255, 255, 31] = prediction[177, 128, 31] = prediction[178, 128, 31] = 1 + index
    return truth.astype(np.uint8), prediction.astype(np.uint8)


def absent() -> tuple[Any, Any]:
    """No N in either, and T only predicted."""
    truth, prediction = np.zeros(SHAPE, np.uint8), np.zeros(SHAPE, np.uint8)
    truth[100:156, 90:200, 8] = 2
    prediction[104:156, 90:210, 8] = 2
    prediction[104:110, 90:210, 9] = 1
    return truth, prediction


def grids(sequence: str, index: int) -> tuple[Any, Any]:
    if sequence == "golden-mixed":
        return mixed(index)
    return absent() if sequence == "golden-absent" else (np.zeros(SHAPE, np.uint8), np.zeros(SHAPE, np.uint8))


def masks_of(index: int) -> dict[str, Any]:
    """A cone of rays and a wedge of view; `all` needs none."""
    x, y, z = np.ogrid[:256, :256, :32]
    lidar = (abs(x - 128) + abs(y - 128)) // 16 + 2 > abs(z - 10)
    camera = (x >= 128 + index) & (abs(y - 128) <= x - 120) & (z >= 0)
    return {"mask_lidar": lidar.astype(np.uint8), "mask_camera": camera.astype(np.uint8)}


def npz(arrays: dict[str, Any]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for key, array in arrays.items():
            raw = io.BytesIO()
            np.lib.format.write_array(raw, np.ascontiguousarray(array), version=(1, 0))
            member = zipfile.ZipInfo(f"{key}.npy", EPOCH)
            member.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(member, raw.getvalue(), compresslevel=9)
    return file.getvalue()


def submission(frames: dict[str, Any]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for token, grid in frames.items():
            archive.writestr(zipfile.ZipInfo(f"{token}.npz", EPOCH), npz({"semantics": grid}))
    return file.getvalue()


def files() -> dict[str, bytes]:
    """All but `expected.json`, by name."""
    predictions: dict[str, Any] = {}
    made = {"manifest.json": (json.dumps({"stone_manifest": 1, "sequences": TOKENS}, indent=1) + "\n").encode()}
    for name, tokens in TOKENS.items():
        for index, token in enumerate(tokens):
            truth, predictions[token] = grids(name, index)
            made[f"gts/{name}/{token}/labels.npz"] = npz({"semantics": truth, **masks_of(index)})
    unknown = np.where(predictions[TOKENS["golden-absent"][0]] == 0, 255, 2).astype(np.uint8)
    refused = {**predictions, TOKENS["golden-absent"][0]: unknown}
    return {**made, "submission.zip": submission(predictions), "refused.zip": submission(refused)}


def read(npz: bytes) -> dict[str, Any]:
    with np.load(io.BytesIO(npz)) as arrays:
        return dict(arrays)


def expected(made: dict[str, bytes]) -> dict[str, Any]:
    """What the slow metric says of these files."""
    with zipfile.ZipFile(io.BytesIO(made["submission.zip"])) as archive:
        predictions = {name.removesuffix(".npz"): read(archive.read(name))["semantics"] for name in archive.namelist()}
    by_mask = {}
    for mask in MASKS:
        counts = {}
        for name, tokens in TOKENS.items():
            for token in tokens:
                labels = read(made[f"gts/{name}/{token}/labels.npz"])
                evaluated = np.ones(SHAPE, bool) if mask == "all" else labels[f"mask_{mask}"] != 0
                counts[token] = slow_counts(labels["semantics"], predictions[token], evaluated)
        by_mask[mask] = {
            "frames": {token: vars(one) for token, one in counts.items()},
            "total": said(list(counts.values())),
            "sequences": {name: said([counts[token] for token in tokens]) for name, tokens in TOKENS.items()},
        }
    refusal = {"file": "refused.zip", "code": "label_out_of_range", "frame": TOKENS["golden-absent"][0]}
    return {"golden": 1, "submission": "submission.zip", "masks": by_mask, "refused": refusal}


def said(counts: list[Counts]) -> dict[str, Any]:
    cells, columns = added(counts)
    ratios, clear = {metric: slow_ratios(cells, metric) for metric in METRICS}, added_columns(counts)
    return {
        "confusion": cells,
        "metrics": ratios,
        "extras": slow_extras(cells, columns, clear),
        "tolerant": slow_tolerant(counts),
        "columns": slow_ratios(clear, METRICS[0]),
    }


def main() -> None:
    made = files()
    made["expected.json"] = (json.dumps(expected(made), separators=(",", ":")) + "\n").encode()
    for name, content in made.items():
        (FOLDER / name).parent.mkdir(parents=True, exist_ok=True)
        (FOLDER / name).write_bytes(content)


if __name__ == "__main__":
    main()
