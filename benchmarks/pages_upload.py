"""Speed of hashing and uploading a bag in a page: `python -m benchmarks.pages_upload [--mb 512]`.

A file of random bytes goes through Chromium to the API's own process on loopback. It is hashed (sha256 by WebAssembly),
then sent in pieces that are each hashed again, and verified as a whole by the platform. The second row is the disk's
time for the same bytes with a flush at the end.
"""

import argparse
import os
import shutil
import tempfile
import time
from pathlib import Path

from playwright.sync_api import expect, sync_playwright

from services.runtime.database.migrate import upgrade
from services.runtime.platform import open_platform
from services.runtime.settings import Settings
from testing.api.process import running_api
from testing.api.serving import person
from testing.web.browsing import Site

BLOCK = 1 << 20
LONGEST_MS = 600_000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mb", type=int, default=512)
    options = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="stone-pages-upload-"))
    try:
        size_bytes = options.mb * 10**6
        disk_s = written(folder / "run.mcap", size_bytes)
        counted_s, sent_s = through_the_page(folder)
        for name, took_s in (("written to disk", disk_s), ("counted", counted_s), ("sent", sent_s)):
            print(f"{name:>16}: {took_s:6.2f} s {size_bytes / took_s / 1e6:8.1f} MB/s")
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def written(path: Path, size_bytes: int) -> float:
    """Return the seconds to write random bytes to the disk."""
    blocks = [os.urandom(BLOCK) for _ in range(64)]
    begun = time.perf_counter()
    with path.open("wb") as file:
        for number in range(size_bytes // BLOCK):
            file.write(blocks[number % 64])
        file.write(os.urandom(size_bytes % BLOCK))
        os.fsync(file.fileno())
    return time.perf_counter() - begun


def through_the_page(folder: Path) -> tuple[float, float]:
    """Return the seconds until the file was hashed, and from then on until it was sent."""
    settings = Settings(data_folder=folder / "data")
    settings.root.mkdir(parents=True)
    upgrade(settings)
    platform = open_platform(settings)
    curator = person(platform, "curator")
    with running_api(settings, folder / "api.log") as process, sync_playwright() as playwright:
        arguments = ["--no-sandbox", "--use-angle=swiftshader"]
        chromium = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=arguments)
        with Site(process.url, platform, chromium).visit(curator) as page:
            page.goto("/sequences/new")
            page.locator("[data-files]").set_input_files(folder / "run.mcap")
            moments = []
            page.get_by_role("button", name="Upload").click()
            for bar in ("counted", "sent"):
                begun = time.perf_counter()
                expect(page.locator(f".transfer [data-{bar}-part]")).to_have_text("100 %", timeout=LONGEST_MS)
                moments.append(time.perf_counter() - begun)
        chromium.close()
    platform.database.close()
    return moments[0], moments[1]


if __name__ == "__main__":
    main()
