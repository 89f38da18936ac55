"""Static files of the pages: one style sheet, our modules, libraries of others, pictures.

**Conventions.** Everything is read when the process starts, compressed once, and addressed below a digest of it all, so
a browser keeps it for ever and never mixes two versions. Libraries are named in `LIBRARIES`; nothing else of
`node_modules` is served, and nothing is loaded from another host.
"""

import gzip
import json
from base64 import b64encode
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path

from fastapi import APIRouter, Request, Response

from api.compression import takes_gzip
from api.errors import NotFoundError
from stone.errors import Refused

router = APIRouter()
FOLDER = Path(__file__).parent
PACKAGES, BUILT, STYLES, PICTURES = (FOLDER / name for name in ("node_modules", "built", "styles", "pictures"))
FOR_EVER = "public, max-age=31536000, immutable"
STYLE_ORDER = ("tokens", "base", "layout", "components", "charts")
"""Style sheets that come first, in this order; the others follow by name."""
LIBRARIES = {
    "htmx.org": "htmx.org/dist/htmx.esm.min.js",
    "fzstd": "fzstd/esm/index.mjs",
    "tus-js-client": "tus-js-client/dist/tus.min.js",
    "hash-wasm/sha256": "hash-wasm/dist/sha256.umd.min.js",
}
"""Files of packages by the names that modules import them with."""
BUNDLED = ("three",)
"""Libraries bundled from `libraries/<name>.js`, which exports the used parts: 134 kB of three.js instead of 419 kB."""
MEDIA_TYPES = {
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".mjs": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
    ".png": "image/png",
}


@dataclass(frozen=True)
class Asset:
    """A file as it is sent."""

    content: bytes
    media_type: str

    @cached_property
    def compressed(self) -> bytes:
        return gzip.compress(self.content, 9, mtime=0)


@dataclass(frozen=True)
class Assets:
    """All files by the path below the digest."""

    files: Mapping[str, Asset]

    @cached_property
    def digest(self) -> str:
        hashed = sha256()
        for path, asset in sorted(self.files.items()):
            hashed.update(f"{path}\0{len(asset.content)}\0".encode() + asset.content)
        return hashed.hexdigest()[:16]

    def url(self, path: str) -> str:
        """Return the URL of the file. Raises KeyError if it is missing, which is a fault of the platform."""
        if path not in self.files:
            raise KeyError(path)
        return f"/assets/{self.digest}/{path}"

    @cached_property
    def import_map(self) -> str:
        """The import map for bare names in modules, as JSON for the page's head."""
        imports = {name: self.url(f"libraries/{path}") for name, path in LIBRARIES.items()}
        imports |= {name: self.url(f"modules/libraries/{name}.js") for name in BUNDLED}
        return json.dumps({"imports": imports}, separators=(",", ":"))

    @cached_property
    def import_map_hash(self) -> str:
        """The hash by which the page's policy lets the import map through."""
        return f"sha256-{b64encode(sha256(self.import_map.encode()).digest()).decode()}"


@router.get("/assets/{digest}/{path:path}")
def send(digest: str, path: str, request: Request) -> Response:
    """Return a file, compressed if the browser accepts that. Raises `NotFoundError`."""
    assets: Assets = request.app.state.pages.assets
    asset = assets.files.get(path) if digest == assets.digest else None
    if asset is None:
        raise NotFoundError("asset", path)
    headers = {"Cache-Control": FOR_EVER, "Vary": "Accept-Encoding"}
    if not takes_gzip(request):
        return Response(asset.content, media_type=asset.media_type, headers=headers)
    return Response(asset.compressed, media_type=asset.media_type, headers=headers | {"Content-Encoding": "gzip"})


def built_assets() -> Assets:
    """Return the files of this checkout. Raises `pages_not_built`."""
    return Assets(dict(_files()))


def _files() -> Iterator[tuple[str, Asset]]:
    yield "app.css", Asset(_style_sheet(), MEDIA_TYPES[".css"])
    for folder, prefix in ((BUILT, "modules"), (PICTURES, "pictures")):
        for path in sorted(folder.rglob("*")):
            if path.suffix in MEDIA_TYPES:
                yield f"{prefix}/{path.relative_to(folder).as_posix()}", _asset(path)
    for file in LIBRARIES.values():
        yield f"libraries/{file}", _asset(PACKAGES / file)
    if not (BUILT / "app.js").exists():
        raise pages_not_built(BUILT / "app.js")


def _asset(path: Path) -> Asset:
    if not path.exists():
        raise pages_not_built(path)
    return Asset(path.read_bytes(), MEDIA_TYPES[path.suffix])


def _style_sheet() -> bytes:
    names = {path.stem: path for path in sorted(STYLES.glob("*.css"))}
    ordered = [*STYLE_ORDER, *(name for name in names if name not in STYLE_ORDER)]
    return b"\n".join(names[name].read_bytes() for name in ordered)


def pages_not_built(missing: Path) -> Refused:
    return Refused("pages_not_built", f"{missing} is missing: the pages' modules are not built; run `make install`")
