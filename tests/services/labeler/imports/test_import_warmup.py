"""What a child of an import calls compiled is compiled before it is forked."""

import subprocess
import sys
from pathlib import Path

import pytest

from testing.worlds.published_datasets import SyntheticDataset, made_labels, write_published_tar

ROOT = Path(__file__).resolve().parents[4]
ASKED = """
import sys
from pathlib import Path
from numba.core import event
from services.labeler.imports.kernel_warmup import warm_imports
from testing.worlds.imported import write_import
warm_imports()

class Told(event.Listener):
    def on_start(self, told):
        print(told.data["dispatcher"].py_func.__qualname__)
    def on_end(self, told):
        pass

event.register("numba:compile", Told())
write_import(Path(sys.argv[1]), Path(sys.argv[2]))
"""


@pytest.mark.release
def test_no_kernel_of_an_import_is_compiled_in_its_child(tmp_path: Path) -> None:
    """Catches alone a kernel that every child compiles anew, some seconds each, because the warm-up forgets it."""
    what = SyntheticDataset(scenes=1, frames=2, labels=(made_labels(),))
    tar = write_published_tar(tmp_path / "field.tar", what)
    command = [sys.executable, "-c", ASKED, str(tar), str(tmp_path / "out")]
    told = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True, timeout=600)
    assert told.stdout.split() == []
