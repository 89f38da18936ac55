"""A submission that takes over its counting child reveals nothing of the ground truth that the child reads.

**Conventions.** A forged child reads the first bytes of the pack and sends them through one channel after another. The
test compares everything that a team may see of two packs: progress, verdict, code and sentence. Time is not tested.

Catches alone a word, a number or an exit status of that child in anything that a team reads.
"""

import ctypes
import errno
import json
import os
import signal
import struct
from collections.abc import Callable
from dataclasses import dataclass
from math import log2
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from services.eval import examination
from services.eval.examination import ARRAYS, Counts, Examination, ExaminedRange, counts_in, examine
from services.eval.ground_truth import read_truth
from services.eval.truth_pack import TruthPack, write_truth_pack
from services.eval.truth_supports import can_be_counted
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.sandbox import SandboxLimits, SandboxWatch, sandboxed_with_progress
from services.runtime.sandbox.messages import ANSWER, CRASH, REFUSAL, TICK, send_message
from stone.errors import PlatformFaultError, Refused, StoneError
from stone_submissions.ground_truth import find_ground_truth
from stone_submissions.validation import validate
from testing.worlds.submission_files import write_submission
from tests.services.eval.conftest import World

SECRET_BYTES = 75_000
Forgery = Callable[[bytes, Any], bytes]


def problems_full_of(secret: bytes) -> bytes:
    """Return a verdict that carries 75,000 bytes: a hundred problems with five texts of 200 characters each."""
    texts = [secret[start : start + 150].hex()[:200] for start in range(0, SECRET_BYTES, 150)]
    names = ("code", "file", "frame", "expected", "actual")
    errors = [dict(zip(names, texts[5 * row : 5 * row + 5], strict=True)) for row in range(100)]
    words = json.dumps({"ok": False, "errors": errors, "errors_total": int.from_bytes(secret[:4])}).encode()
    return struct.pack("<I", len(words)) + words


def report(secret: bytes, progress: Any) -> bytes:
    for start in range(0, 3000, 100):
        progress(secret[start : start + 50].hex(), int.from_bytes(secret[start : start + 8]), secret[start])
    return b"\1"


def kill_by(secret: bytes, _: Any) -> bytes:
    signal.signal(signal.SIGSEGV, signal.SIG_DFL)
    os.kill(os.getpid(), (signal.SIGSEGV, signal.SIGABRT, signal.SIGILL, signal.SIGBUS)[secret[0] % 4])
    return b""


def kill_outright(*_: object) -> bytes:
    os.kill(os.getpid(), signal.SIGKILL)
    return b""


def raising(error: Callable[[str], BaseException]) -> Forgery:
    def say(secret: bytes, _: Any) -> bytes:
        raise error(secret[:1000].hex())

    return say


def writing(kind: int) -> Forgery:
    def say(secret: bytes, progress: Any) -> bytes:
        send_message(progress.__self__.writing, kind, json.dumps({"exception": secret[:500].hex()}).encode())
        os._exit(0)

    return say


def writing_no_word(secret: bytes, progress: Any) -> bytes:
    os.write(progress.__self__.writing, struct.pack("<BQ", 9 + secret[0] % 200, int.from_bytes(secret[:7])))
    os._exit(0)


FORGERIES: dict[str, Forgery] = {
    "a verdict of problems": lambda secret, _: problems_full_of(secret),
    "counts of another number": lambda secret, _: b"\0" + secret[:4000],
    "counts that are the pack": lambda secret, _: b"\0" + secret[: examination.answer_bytes(3)],
    "outcomes that are none": lambda secret, _: bytes([3 + secret[0] % 250]) + secret[:9],
    "not counted, with more": lambda secret, _: b"\1" + secret[:1000],
    "damaged, with more": lambda secret, _: b"\2" + secret[:1000],
    "more than the answer may be": lambda secret, _: secret * 20,
    "progress": report,
    "a refusal": raising(lambda text: Refused(f"c{text[:50]}", text)),
    "a fault of the platform": raising(lambda text: PlatformFaultError("ground_truth_damaged", text)),
    "the wish to stop": raising(JobCancelledError),
    "the name of an exception": raising(lambda text: type(f"E{text[:200]}", (Exception,), {})(text)),
    "the name of an error of the machine": raising(
        lambda text: type(f"E{text[:200]}", (OSError,), {})(errno.EIO, text)
    ),
    "memory": raising(lambda _: MemoryError()),
    "an exit status": lambda secret, _: os._exit(secret[0]),
    "a signal": kill_by,
    "a kill": kill_outright,
    "a written refusal": writing(REFUSAL),
    "a written crash": writing(CRASH),
    "a written answer": writing(ANSWER),
    "a written tick": writing(TICK),
    "no word at all": writing_no_word,
}


@dataclass(frozen=True)
class Packs:
    """A sound and a wrong submission, and two packs with equal counts of the truth alone but different bytes."""

    manifest: Path
    tokens: tuple[str, ...]
    sound: Path
    wrong: Path
    packs: tuple[Path, Path]


@pytest.fixture(scope="module")
def standing(world: World, tmp_path_factory: pytest.TempPathFactory) -> Packs:
    folder = tmp_path_factory.mktemp("forged")
    truth = find_ground_truth(world.folder)
    paths = truth.paths()
    packs = (folder / "a" / "truth.pack", folder / "b" / "truth.pack")
    for pack in packs:
        pack.parent.mkdir()
        write_truth_pack(pack, truth.manifest, lambda token: read_truth(paths[token], "all"))
    other = bytearray(packs[1].read_bytes())
    other[8:SECRET_BYTES] = bytes(byte ^ 0x5A for byte in other[8:SECRET_BYTES])
    packs[1].write_bytes(other)
    write_submission(folder / "sound.zip", world.predictions.items())
    spoilt = {token: np.where(grid == 0, 9, grid).astype(np.uint8) for token, grid in world.predictions.items()}
    write_submission(folder / "wrong.zip", spoilt.items())
    return Packs(world.manifest_path, truth.manifest.tokens, folder / "sound.zip", folder / "wrong.zip", packs)


def seen(standing: Packs, zip_path: Path, pack: Path) -> tuple[Any, ...]:
    """Return everything that a team may read of a range: its progress and its end."""
    progress = list[tuple[str, int, int]]()
    watch = SandboxWatch(progress=lambda *said: progress.append(said))
    try:
        found = examine(Examination(zip_path, standing.tokens, (0, 3), pack), watch)
    except StoneError as error:
        return error.code, str(error), isinstance(error, PlatformFaultError), tuple(dict.fromkeys(progress))
    return str(found.validation), found.counts is not None, tuple(dict.fromkeys(progress))


def forge(monkeypatch: pytest.MonkeyPatch, forgery: Forgery) -> None:
    def count_submission(asked: Examination, progress: Any) -> bytes:
        assert asked.pack_path is not None
        return forgery(asked.pack_path.read_bytes()[8 : 8 + SECRET_BYTES], progress)

    monkeypatch.setattr(examination, "count_submission", count_submission)


@pytest.mark.parametrize("channel", FORGERIES)
@pytest.mark.parametrize("which", ["sound", "wrong"])
def test_no_byte_of_a_pack_leaves(which: str, channel: str, standing: Packs, monkeypatch: pytest.MonkeyPatch) -> None:
    forge(monkeypatch, FORGERIES[channel])
    one, other = (seen(standing, getattr(standing, which), pack) for pack in standing.packs)
    assert one == other


def test_a_child_chooses_among_few_ends_and_a_wrong_file_keeps_its_words(
    standing: Packs, monkeypatch: pytest.MonkeyPatch
) -> None:
    ends: dict[str, set[Any]] = {"sound": set(), "wrong": set()}
    for forgery in FORGERIES.values():
        forge(monkeypatch, forgery)
        for which, found in ends.items():
            found.add(seen(standing, getattr(standing, which), standing.packs[0])[:2])
    words = (str(validate(standing.wrong, standing.manifest)), False)
    assert words in ends["wrong"]
    assert {end[0] for end in ends["sound"]} == {"scoring_crashed", "scoring_interrupted", "ground_truth_damaged"}
    assert {end[0] for end in ends["wrong"] - {words}} == {
        "scoring_crashed", "scoring_interrupted", "ground_truth_damaged",
    }  # fmt: skip
    assert log2(max(map(len, ends.values()))) <= 2, "bits of a range, as docs/security/threat-model.md states"


def test_progress_is_that_of_honest_blocks(standing: Packs, monkeypatch: pytest.MonkeyPatch) -> None:
    forge(monkeypatch, report)
    *_, progress = seen(standing, standing.wrong, standing.packs[0])
    assert set(progress) <= {("score", 3, 3), ("validate", 3, 3)}


def honest(standing: Packs) -> ExaminedRange:
    return examine(Examination(standing.sound, standing.tokens, (0, 3), standing.packs[0]), SandboxWatch())


def moved(name: str, place: tuple[int, ...], by: int) -> Callable[[Counts], Counts]:
    def move(counts: Counts) -> Counts:
        arrays = {key: array.copy() for key, array in counts.arrays().items()}
        arrays[name][place] += by
        return counts_in(arrays)

    return move


IMPOSSIBLE: dict[str, Callable[[Counts], Counts]] = {
    "a voxel more": moved("confusions", (0, 1, 2, 2), 1),
    "a voxel less": moved("confusions", (2, 0, 0, 0), -1),
    "drivable in the truth": moved("bev", (1, 0, 1), 1),
    "drivable in both": moved("bev", (1, 0, 0), 1),
    "more columns than there are": moved("bev", (1, 2, 2), 65536),
    "a negative column": moved("bev", (1, 0, 2), -65536),
    "more pairs than voxels": moved("pairs", (0, 0, 1), 2**22),
    "a negative pair": moved("pairs", (0, 2, 0), -(2**22)),
    "a column more": moved("columns", (0, 0, 3, 3), 1),
    "a late voxel more": moved("late", (0, 1, 1), 1),
}


@pytest.mark.parametrize("case", IMPOSSIBLE)
def test_counts_that_no_prediction_has_are_refused(case: str, standing: Packs, monkeypatch: pytest.MonkeyPatch) -> None:
    counts = honest(standing).counts
    assert counts is not None
    told = b"\0" + IMPOSSIBLE[case](counts).raw()
    forge(monkeypatch, lambda *_: told)
    assert seen(standing, standing.sound, standing.packs[0])[0] == "scoring_crashed"


def test_what_is_counted_in_frames_that_are_not_sampled_is_refused(standing: Packs) -> None:
    counts = honest(standing).counts
    assert counts is not None
    with TruthPack(standing.packs[0]) as pack:
        supports = pack.supports()
    every = np.ones(3, np.bool_)
    assert can_be_counted(counts.arrays(), supports, every)
    assert not can_be_counted(counts.arrays(), supports, np.array([True, False, True]))
    assert not can_be_counted({**counts.arrays(), "columns": counts.arrays()["columns"] * 0}, supports, every)


def test_supports_are_those_of_the_labels(standing: Packs, world: World) -> None:
    """The oracle is numpy: voxels by class, and columns with a T or P but no N."""
    with TruthPack(standing.packs[0]) as pack:
        supports = pack.supports().sum(axis=1)
        assert pack.tokens == standing.tokens
    for row, token in zip(supports, standing.tokens, strict=True):
        grid = world.labels[token]
        drivable = (((grid == 1) | (grid == 2)).any(axis=2) & ~(grid == 3).any(axis=2)).sum()
        assert row[:5].tolist() == [*np.bincount(grid.ravel(), minlength=4), drivable]
        assert row[5:9].sum() == grid.shape[0] * grid.shape[1]


def test_a_pack_of_an_earlier_version_bounds_the_voxels(standing: Packs) -> None:
    counts = honest(standing).counts
    assert counts is not None
    with TruthPack(standing.packs[0]) as pack:
        supports: NDArray[np.int32] = pack.supports()
    supports[..., 4:] = -1
    every = np.ones(3, np.bool_)
    assert can_be_counted(counts.arrays(), supports, every)
    assert not can_be_counted(IMPOSSIBLE["a voxel more"](counts).arrays(), supports, every)


def test_the_child_that_finds_the_words_is_given_no_ground_truth(
    standing: Packs, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = list[SandboxLimits]()

    def noted(work: Any, limits: SandboxLimits, watch: SandboxWatch) -> bytes:
        asked.append(limits)
        return sandboxed_with_progress(work, limits, watch)

    monkeypatch.setattr(examination, "sandboxed_with_progress", noted)
    assert not seen(standing, standing.wrong, standing.packs[0])[1]
    assert [limits.reads for limits in asked] == [(standing.wrong, standing.packs[0]), (standing.wrong,)]
    assert [limits.may_quote for limits in asked] == [False, True]
    assert [limits.folder for limits in asked] == [None, None], "the one leaves no file to the other"


def test_the_channels_are_read_in_full() -> None:
    """The forged verdict carries at least 50,000 bytes of the secret, and 532 bytes of counts per frame exist."""
    secret = os.urandom(SECRET_BYTES)
    words = json.loads(problems_full_of(secret)[4:])
    assert sum(len(text) // 2 for error in words["errors"] for text in error.values()) >= 50_000
    assert ctypes.sizeof(ctypes.c_int32) * sum(np.prod(shape) for shape in ARRAYS.values()) == 532
