"""What is lost of the store is found, put back by its content, and made again where nobody has it."""

import hashlib
import json
from pathlib import Path

import pytest

from services.maintenance import store_check
from services.maintenance.store_check import DamagedBlob, damaged_blobs, forget_derived, restore_objects
from services.runtime.access.users import create_user
from services.runtime.orm import Artefact, Blob, CalibrationRow, Export, Job, LabelSet, SequenceRow
from services.runtime.orm.base import new_id
from services.runtime.platform import Platform
from services.runtime.store.blobs import keep, link, prepare

CONTENTS = {"kept": b"kept " * 100, "gone": b"gone " * 100, "cut": b"cut " * 100, "changed": b"changed " * 100}


def laid(platform: Platform, folder: Path) -> dict[str, Blob]:
    """A calibration of each content, as blobs by name."""
    with platform.database.transaction() as session:
        owner = create_user(session, "ada", "curator")
        blobs = {}
        for name, content in CONTENTS.items():
            path = folder / name
            path.write_bytes(content)
            blobs[name] = keep(session, platform.store, path)
            facts = {"filename": name, "sha256": blobs[name].sha256, "blob_sha256": blobs[name].sha256}
            session.add(CalibrationRow(owner_id=owner.id, name=name, version=1, sensors=[], findings=[], **facts))
            session.flush()
    return blobs


def harm(platform: Platform, blobs: dict[str, Blob]) -> None:
    """One object deleted, one cut, one changed in place."""
    store = platform.store
    store.delete(blobs["gone"].object_key)
    for name, content in (("cut", b"cut"), ("changed", CONTENTS["changed"].upper())):
        store.local(blobs[name].object_key).write_bytes(content)


@pytest.fixture
def blobs(platform: Platform, tmp_path: Path) -> dict[str, Blob]:
    folder = tmp_path / "brought"
    folder.mkdir()
    made = laid(platform, folder)
    harm(platform, made)
    return made


def faults(platform: Platform, *, is_read: bool) -> dict[str, str]:
    return {one.sha256: one.fault for one in damaged_blobs(platform, is_read=is_read)}


def test_what_is_gone_cut_or_changed_is_found_with_what_names_it(platform: Platform, blobs: dict[str, Blob]) -> None:
    looked = {blobs["gone"].sha256: "missing", blobs["cut"].sha256: "size"}
    assert faults(platform, is_read=False) == looked
    assert faults(platform, is_read=True) == {**looked, blobs["changed"].sha256: "bytes"}
    assert {one.named_by for one in damaged_blobs(platform)} == {("calibrations",)}


def test_what_is_lost_is_put_back_by_content_under_any_name(
    platform: Platform, blobs: dict[str, Blob], tmp_path: Path
) -> None:
    copies = tmp_path / "somewhere" / "else"
    copies.mkdir(parents=True)
    for number, name in enumerate(CONTENTS):
        (copies / f"{number}.bin").write_bytes(CONTENTS[name])
    (copies / "4.bin").write_bytes(b"x" * len(CONTENTS["gone"]))
    (copies / "link").symlink_to(copies / "1.bin")
    lost = list(damaged_blobs(platform, is_read=True))
    assert len(restore_objects(platform, lost, tmp_path / "somewhere")) == 3
    assert list(damaged_blobs(platform, is_read=True)) == []
    for name, blob in blobs.items():
        assert b"".join(platform.store.read(blob.object_key)) == CONTENTS[name]


def test_files_of_other_content_put_nothing_back(platform: Platform, blobs: dict[str, Blob], tmp_path: Path) -> None:
    lost = list(damaged_blobs(platform))
    wrong = tmp_path / "wrong"
    wrong.mkdir()
    (wrong / lost[0].sha256).write_bytes(b"y" * lost[0].size_bytes)
    assert restore_objects(platform, lost, wrong) == []


@pytest.mark.parametrize("way", ["prepared", "kept"])
def test_a_content_that_comes_again_mends_what_is_lost(
    platform: Platform, blobs: dict[str, Blob], tmp_path: Path, way: str
) -> None:
    again = tmp_path / "brought" / "gone"
    if way == "prepared":
        prepared = prepare(platform.store, platform.database, again)
        with platform.database.transaction() as session:
            blob = link(session, prepared)
    else:
        with platform.database.transaction() as session:
            blob = keep(session, platform.store, again)
    assert blob.object_key == blobs["gone"].object_key
    assert b"".join(platform.store.read(blob.object_key)) == CONTENTS["gone"]


def labelled(platform: Platform, blob: Blob) -> tuple[str, str]:
    """A sequence with a label set of this content and an export of it; the sequence's and the label set's ids."""
    with platform.database.transaction() as session:
        owner = create_user(session, "bea", "curator")
        sequence = SequenceRow(name=new_id(), owner_id=owner.id)
        session.add(sequence)
        session.flush()
        run = Job(id=new_id(), owner_id=owner.id, sequence_id=sequence.id, kind="sequence.process", state="succeeded")
        run.root_id = run.id
        session.add(run)
        session.flush()
        made = {"parameters": {}, "code_version": "1", "frames": 1}
        labels = LabelSet(sequence_id=sequence.id, job_id=run.id, recipe="a" * 64, **made)
        session.add(labels)
        session.flush()
        session.add(
            Artefact(
                label_set_id=labels.id, name="x", media_type="y", blob_sha256=blob.sha256, size_bytes=blob.size_bytes
            )
        )
        export = {"format": "mesh", "recipe": "b" * 64, "code_version": "1"}
        session.add(Export(sequence_id=sequence.id, label_set_id=labels.id, job_id=run.id, **export))
        return sequence.id, labels.id


def test_labels_that_lost_something_are_forgotten_and_others_stay(platform: Platform, blobs: dict[str, Blob]) -> None:
    sequence_id, lost_labels = labelled(platform, blobs["gone"])
    lost = [one for one in damaged_blobs(platform) if one.fault == "missing"]
    assert "artefacts" in lost[0].named_by
    assert forget_derived(platform, [DamagedBlob("0" * 64, "blobs/00/x", 1, "missing", ())]) == 0
    assert forget_derived(platform, lost) == 2
    with platform.database.reading() as session:
        assert session.get(LabelSet, lost_labels) is None
        assert session.get(SequenceRow, sequence_id) is not None
        assert session.get(Blob, blobs["gone"].sha256) is not None, "the calibration still names it"


def test_the_program_says_what_is_lost_puts_it_back_and_is_content(
    platform: Platform, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    brought = tmp_path / "brought"
    brought.mkdir()
    harm(platform, laid(platform, brought))
    monkeypatch.setenv("STONE_DATA_FOLDER", str(platform.settings.root))
    assert store_check.main([]) == 1
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {line["fault"] for line in lines} == {"missing", "size"}
    assert store_check.main(["--bytes", "--from", str(brought)]) == 0
    assert "3 objects were restored" in capsys.readouterr().err
    assert store_check.main(["--bytes"]) == 0
    assert hashlib.sha256(CONTENTS["gone"]).hexdigest() not in capsys.readouterr().out
