"""The page's reader of zips and the platform's say the same of every archive, honest or hostile, as far as one can see
in its directory.

**Conventions.** Both are given the same bytes; what is compared is the code, file and frame of each problem, in order.
"""

import io
import random
import re
import stat
import struct
import zipfile
from base64 import b64encode
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from playwright.sync_api import Page

from stone_base.label_grid import GRIDS, LabelGrid
from stone_submissions.archive import open_submission
from testing.web.browsing import Site
from tests.services.eval.grid_attacks import GRID_ATTACKS, OWN, honest, submission
from tests.services.eval.grid_attacks import TOKENS as ATTACKED_TOKENS

TOKENS = tuple(f"{number:032x}" for number in (11, 22, 33, 44))
PAPER = np.zeros((256, 256, 32), np.uint8)
HINTED = re.compile(r"Expected axis order x, y, z: (.+?)(?: if |:|$)")
Found = list[tuple[str, str, str | None]]
READ = """async ({at, zips, tokens}) => {
  const { examined, manifestOf } = await import(at);
  const manifest = manifestOf({ sequences: { run: tokens } });
  const said = [];
  for (const zip of zips) {
    const bytes = Uint8Array.from(atob(zip), (one) => one.charCodeAt(0));
    const { problems } = await examined(new File([bytes], "run.zip"), manifest);
    said.push(problems.map(({ code, file, frame }) => [code, file, frame]));
  }
  return said;
}"""
END_64 = struct.Struct("<4sQ2H2I4Q")


def packed(names: list[str], method: int = zipfile.ZIP_DEFLATED, size_bytes: int = 30) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", method) as archive:
        for name in names:
            archive.writestr(name, b"\1" * size_bytes)
    return content.getvalue()


def whole(folder: str = "") -> list[str]:
    return [f"{folder}{token}.npz" for token in TOKENS]


def widened(archive: bytes) -> bytes:
    """The same archive with a zip64 end, the narrow one saying 0xFF… throughout."""
    end = archive.rfind(b"PK\5\6")
    _, _, _, _, entries, length, offset, _ = struct.unpack("<4s4H2IH", archive[end:])
    record = END_64.pack(b"PK\6\6", END_64.size - 12, 45, 45, 0, 0, entries, entries, length, offset)
    locator = struct.pack("<4sIQI", b"PK\6\7", 0, end, 1)
    narrow = struct.pack("<4s4H2IH", b"PK\5\6", 0, 0, 0xFFFF, 0xFFFF, 0xFFFFFFFF, 0xFFFFFFFF, 0)
    return archive[:end] + record + locator + narrow


def linked() -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        link = zipfile.ZipInfo(f"{TOKENS[0]}.npz")
        link.create_system, link.external_attr = 3, (stat.S_IFLNK | 0o777) << 16
        archive.writestr(link, "/etc/passwd")
    return content.getvalue()


def flagged(archive: bytes, flag: int) -> bytes:
    """With a flag set in the directory's first record."""
    at = archive.find(b"PK\1\2") + 8
    return archive[:at] + struct.pack("<H", flag) + archive[at + 2 :]


@pytest.mark.filterwarnings("ignore:Duplicate name")
def told() -> Iterator[bytes]:
    """Archives that are each wrong, or right, in their own way."""
    yield packed(whole())
    yield packed(whole("run 7/"), zipfile.ZIP_STORED)
    yield packed(["run/", *whole("run/")])
    yield widened(packed(whole()))
    yield packed(whole()[1:])
    yield packed([*whole(), "README.md", "__MACOSX/._a", ".DS_Store", "ünï/x.npz", "\u2603.txt"])
    yield packed([*whole()[:2], *(f"deep/er/{name}" for name in whole()[2:])])
    yield packed(whole("../"))
    yield packed([*whole(), "__MACOSX/._a", ".DS_Store", "sub/Thumbs.db", "._x"])
    names = [name.removesuffix(".npz") for name in whole()]
    yield packed([f"gts/s/{name}/labels.npz" for name in names])
    yield packed([*whole()[:1], *(f"gts/s/{name}/labels.npz" for name in names[1:])])
    yield packed([f"sub\\{name}.npz" for name in names])
    yield packed([f"{name}.npy" for name in names])
    yield packed([f"{name.upper()}.npz" for name in names])
    yield packed([f"run/frame_{number:03}.npz" for number in range(len(names))])
    yield packed([f"scene-{number}/{name}.npz" for number, name in enumerate(names)])
    yield packed([*whole(), whole()[0]])
    yield packed(whole(), size_bytes=3 * 2**20 + 1)
    yield packed([])
    yield packed([f"{number}.txt" for number in range(1010)])
    yield packed(["x" * 600])
    yield linked()
    yield from (flagged(packed(whole()), flag) for flag in (1, 1 << 6, 1 << 11, 1 << 13))
    yield b""
    yield b"PK\5\6"
    yield b"not a zip at all" * 9
    yield packed(whole()) + b"more"
    yield b"before" + packed(whole())
    submission = of_frames(zipfile.ZIP_STORED)
    yield from (submission[: len(submission) * part // 7] for part in range(1, 8))
    yield submission + b"more"


def of_frames(method: int, grid: NDArray[np.uint8] = PAPER) -> bytes:
    """A submission of real frames, which are archives themselves."""
    content, inner = io.BytesIO(), frame(np.savez_compressed, semantics=grid)
    with zipfile.ZipFile(content, "w", method) as archive:
        for name in whole():
            archive.writestr(name, inner)
    return content.getvalue()


def mangled(seed: int) -> bytes:
    """An honest archive with a few of its bytes changed, cut or doubled, most of them in its directory."""
    chance = random.Random(seed)
    archive = bytearray(chance.choice((packed(whole()), widened(packed(whole("a/"))), packed([*whole(), "b.txt"]))))
    directory = archive.find(b"PK\1\2")
    for _ in range(chance.randint(1, 3)):
        at = chance.randrange(directory, len(archive))
        act = chance.randrange(6)
        if act == 0:
            del archive[at : at + chance.randint(1, 40)]
        elif act == 1:
            archive[at:at] = archive[at : at + chance.randint(1, 60)]
        else:
            archive[at] = chance.choice((0, 1, 0x7F, 0xFF, chance.randrange(256)))
        directory = min(directory, len(archive) - 2)
    return bytes(archive)


def frame(save: Callable[..., None], **arrays: object) -> bytes:
    content = io.BytesIO()
    save(content, **arrays)
    return content.getvalue()


def by_the_platform(folder: Path, archives: list[bytes]) -> list[Found]:
    path = folder / "run.zip"
    said: list[Found] = []
    for archive in archives:
        path.write_bytes(archive)
        with open_submission(path, TOKENS) as submission:
            said.append([(one.code, one.file, one.frame) for one in submission.problems])
    return said


def modules_of(page: Page) -> str:
    """Return the folder of the page's modules."""
    sheet = page.locator("link[rel=stylesheet]").get_attribute("href") or ""
    return f"{sheet.rpartition('/')[0]}/modules"


def by_the_page(site: Site, archives: list[bytes]) -> list[Found]:
    with site.visit() as page:
        page.goto("/sign-in")
        at = f"{modules_of(page)}/submission/frames.js"
        zips = [b64encode(archive).decode() for archive in archives]
        said = page.evaluate(READ, {"at": at, "zips": zips, "tokens": list(TOKENS)})
    return [[(code, file, frame) for code, file, frame in problems] for problems in said]


SHAPES = {"paper": (256, 256, 32), "release": (200, 200, 16), "long": (160, 80, 8)}
LOOK = """async ({at, grid, tokens, zips}) => {
  const { examined, manifestOf } = await import(at + "frames.js");
  const { checkArrays, shapeHint } = await import(at + "frame_arrays.js");
  const manifest = manifestOf({ sequences: { run: tokens }, ...(grid ? { grid } : {}) });
  const said = [];
  for (const zip of zips) {
    const file = new File([Uint8Array.from(atob(zip), (one) => one.charCodeAt(0))], "run.zip");
    const { frames, problems } = await examined(file, manifest);
    const { problems: [fault = null], valued } = await checkArrays(file, frames, manifest.shape, () => true);
    const hint = fault && shapeHint(manifest.shape, fault.actual);
    said.push(fault ? [problems.length, fault.code, fault.expected, fault.actual, hint] : valued);
  }
  return said;
}"""


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_frames_are_held_against_the_grid_of_the_manifest(site: Site, shape: tuple[int, int, int]) -> None:
    """Every hint, taken as it stands, makes of the array that was found one of the shape."""
    x, y, z = shape
    right = np.zeros(shape, np.uint8)
    turned = (right.transpose(2, 0, 1), right.transpose(0, 2, 1), right[None], right[..., None])
    scored = (np.zeros((4, *shape), np.uint8), np.zeros((*shape, 4), np.uint8))
    others = [np.zeros(other, np.uint8) for other in SHAPES.values() if other != shape]
    arrays = [right, *map(np.ascontiguousarray, turned), *scored, np.asfortranarray(right), *others]
    zips = [b64encode(of_frames(zipfile.ZIP_STORED, array)).decode() for array in arrays]
    given = {"grid": {"shape": shape} if shape != SHAPES["paper"] else None, "tokens": list(TOKENS), "zips": zips}
    with site.visit() as page:
        page.goto("/sign-in")
        said = page.evaluate(LOOK, given | {"at": f"{modules_of(page)}/submission/"})
    assert said[0] == len(TOKENS), "the values of every frame were read"
    for array, (problems, code, expected, actual, hint) in zip(arrays[1:], said[1:], strict=True):
        assert (problems, code) == (0, "bad_shape")
        assert expected.startswith(str(shape))
        assert actual == (str(array.shape) if array.flags.c_contiguous else "Fortran order")
        if any(array is other for other in others):
            assert hint == f"Expected axis order x, y, z, with {x} × {y} × {z} voxels, in C order"
        else:
            made = eval(HINTED.match(hint)[1], {"grid": array, "numpy": np})  # type: ignore[index]
            assert made.shape == shape


ATTACKED = """async ({at, grid, tokens, zips}) => {
  const { examined, manifestOf } = await import(at + "frames.js");
  const { checkArrays } = await import(at + "frame_arrays.js");
  const manifest = manifestOf({ sequences: { run: tokens }, grid });
  const said = [];
  for (const zip of zips) {
    const file = new File([Uint8Array.from(atob(zip), (one) => one.charCodeAt(0))], "run.zip");
    const { frames, problems } = await examined(file, manifest);
    const arrays = await checkArrays(file, frames, manifest.shape, () => true);
    said.push([...problems, ...arrays.problems].map(({ code }) => code));
  }
  return said;
}"""


@pytest.mark.parametrize("grid", [*GRIDS.values(), OWN], ids=lambda grid: grid.name)
def test_a_hostile_submission_has_the_platforms_code_on_the_page_at_every_grid(site: Site, grid: LabelGrid) -> None:
    """Only the platform reads the bytes after a whole array."""
    archives = [submission(grid, honest(grid)), *(attack.made(grid) for attack in GRID_ATTACKS.values())]
    given = {
        "grid": grid.as_record(),
        "tokens": list(ATTACKED_TOKENS),
        "zips": [b64encode(archive).decode() for archive in archives],
    }
    with site.visit() as page:
        page.goto("/sign-in")
        sound, *said = page.evaluate(ATTACKED, given | {"at": f"{modules_of(page)}/submission/"})
    assert sound == []
    for (name, attack), codes in zip(GRID_ATTACKS.items(), said, strict=True):
        is_seen = "bomb" not in name
        assert set(codes) == ({attack.code} if is_seen else set()), name


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_the_page_refuses_what_the_platform_refuses_in_the_same_words(site: Site, tmp_path: Path) -> None:
    archives = [*told(), *(mangled(seed) for seed in range(400))]
    ours = by_the_platform(tmp_path, archives)
    theirs = by_the_page(site, archives)
    differing = [(number, one, two) for number, (one, two) in enumerate(zip(ours, theirs, strict=True)) if one != two]
    assert differing[:2] == [], differing[:2]
    codes = {problem[0] for problems in ours for problem in problems}
    assert codes >= {"missing_frame", "unexpected_file", "duplicate_frame", "too_large", "not_zip", "truncated"}
    assert codes >= {"encrypted", "symlink", "unsupported_zip", "overlapping_files"}
    assert sum(not problems for problems in ours) > 20, "some of the mangled ones are still whole"
