"""A file is the old one or the new one, whole; a file that cannot be read is named."""

import os
import shutil
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from gva_mi import InputError
from gva_mi.core.atomic import atomic_dir, atomic_write
from gva_mi.core.errors import expecting
from gva_mi.core.files import (
    make_room,
    once_a_file,
    read_array,
    read_arrays,
    read_bytes,
    read_json,
    require_array,
    require_keys,
    require_room,
    write_arrays,
    write_json,
)
from gva_mi.core.pickles import read_objects
from gva_mi.core.stamp import start_folder


def contents(folder):
    return {path.name: path.read_text() for path in folder.iterdir()}


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "value.json"
    write_json(path, {"value": 1})
    with pytest.raises(RuntimeError), atomic_write(path) as unfinished:
        unfinished.write_text("{")
        raise RuntimeError("killed")
    assert contents(tmp_path) == {"value.json": '{\n  "value": 1\n}\n'}


def test_unreadable_arrays_are_named(tmp_path):
    path = tmp_path / "a.npz"
    with pytest.raises(InputError, match=r"a\.npz: no such file; expected poses"):
        read_arrays(path, "poses")
    np.savez(path, a=np.array([{}], dtype=object))
    with pytest.raises(InputError, match=r"a\.npz: not a readable \.npz"):
        read_arrays(path, "poses")
    write_arrays(path, b=np.arange(2))
    found = read_arrays(path, "poses")
    assert found["b"].tolist() == [0, 1]
    with pytest.raises(InputError, match="key 'c' is missing; found: b"):
        require_keys(path, found, ("b", "c"))


@pytest.mark.parametrize("read", [read_arrays, read_bytes, read_json, read_objects])
def test_what_is_no_file_is_refused_before_it_is_waited_for(read, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path, kind in (
        (tmp_path / "pipe", "is a device or a pipe"), ("/dev/zero", "is a device or a pipe"),
        (tmp_path, "is a folder"), (tmp_path / "none", "no such file"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=f"{path}: {kind}; expected poses"):
            read(Path(path), "poses")


@pytest.mark.parametrize("read", [read_arrays, read_bytes, read_json, read_objects])
def test_a_file_whose_bytes_cannot_be_read_is_named(read):
    with pytest.raises(InputError, match=r"/proc/self/mem: .*\(Input/output error\); expected"):
        read(Path("/proc/self/mem"), "poses")


def test_an_array_of_another_form_is_named():
    path, good = Path("a.npz"), np.zeros((4, 3), np.float32)
    assert require_array(path, "x", good, (3, 3), (None, 3), largest=1) is good
    half = require_array(path, "x", good.astype(np.float16), (4, 3))
    assert half.dtype == np.float64  # which linear algebra knows
    for array, options, sentence in (
        (np.array(1.0), {}, r"must be \(\*, 3\), got \(\)"),
        (good[:, :2], {}, r"must be \(\*, 3\), got \(4, 2\)"),
        (good.astype(int), {}, "must be floating point, got int64"),
        (good, {"kind": "iu"}, "must be whole numbers, got float32"),
        (good + 2, {"largest": 1}, r"holds 2 at \[0, 0\], expected finite numbers of at most 1$"),
        (good - 2, {"largest": 1}, r"holds -2 at \[0, 0\]"),
        (good * np.nan, {"largest": 1}, r"holds nan at \[0, 0\]"),
    ):
        with pytest.raises(InputError, match=f"^a.npz: 'x' {sentence}"):
            require_array(path, "x", array, (None, 3), **options)


def test_a_link_stays_and_what_it_leads_to_is_written(tmp_path):
    file, run = tmp_path / "there/a.json", tmp_path / "there/run"
    run.mkdir(parents=True)
    (tmp_path / "link.json").symlink_to(file)
    (tmp_path / "run").symlink_to(run)
    require_room(tmp_path / "link.json", overwrite=False)
    write_json(tmp_path / "link.json", 1)
    assert (tmp_path / "link.json").is_symlink() and file.read_text() == "1\n"
    with pytest.raises(InputError, match="link.json: exists already|there/a.json: exists already"):
        require_room(tmp_path / "link.json", overwrite=False)
    for _ in range(2):
        start_folder(tmp_path / "run", "ours.json", overwrite=True, about={})
        assert (tmp_path / "run").is_symlink() and [p.name for p in run.iterdir()] == ["ours.json"]
    with atomic_dir(tmp_path / "run", replaced="ours.json") as folder:
        (folder / "new").write_text("")
    assert (tmp_path / "run").is_symlink() and [p.name for p in run.iterdir()] == ["new"]


def test_only_a_folder_with_the_marker_is_removed(tmp_path, monkeypatch):
    make_room(tmp_path / "new", "ours.json", overwrite=False)
    make_room(tmp_path, "ours.json", overwrite=False)  # empty
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="give --overwrite to replace it"):
        make_room(tmp_path, "ours.json", overwrite=False)
    with pytest.raises(InputError, match="has no ours.json, so gva-mi did not make it"):
        make_room(tmp_path, "ours.json", overwrite=True)
    (tmp_path / "ours.json").write_text("{}")

    def killed(self):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr("gva_mi.core.files.Path.unlink", killed)
        make_room(tmp_path, "ours.json", overwrite=True)
    assert (tmp_path / "ours.json").exists()  # the marker goes last
    make_room(tmp_path, "ours.json", overwrite=True)
    assert not tmp_path.exists()


def test_a_folder_is_replaced_once_the_new_one_is_whole(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "marker").write_text("old")
    with pytest.raises(RuntimeError, match="no source"), atomic_dir(out, "marker") as folder:
        (folder / "half").write_text("new")
        raise RuntimeError("no source")
    assert contents(out) == {"marker": "old"}
    with atomic_dir(out, "marker") as folder:
        (folder / "marker").write_text("new")
    assert (out / "marker").read_text() == "new" and list(tmp_path.iterdir()) == [out]
    with pytest.raises(InputError, match="has no other"), atomic_dir(out, "other"):
        pass
    with pytest.raises(InputError, match="a new or an empty folder"), atomic_dir(out):
        pass
    (out / "marker").unlink()
    with pytest.raises(InputError, match="by another process"), atomic_dir(out) as folder:
        (folder / "marker").write_text("mine")
        (out / "marker").write_text("the other's")
    assert (out / "marker").read_text() == "the other's" and list(tmp_path.iterdir()) == [out]


def test_leftovers_of_a_killed_process_are_removed(tmp_path):
    out, part, old = (tmp_path / name for name in ("out", ".out.gva-mi-part", ".out.gva-mi-old"))
    part.mkdir()
    with atomic_dir(out, "marker") as folder:
        assert folder == part and not list(folder.iterdir())
        (folder / "marker").write_text("new")
    out.rename(old)  # killed between the last two renames
    part.mkdir()
    with pytest.raises(RuntimeError, match="no source"), atomic_dir(out, "marker"):
        raise RuntimeError("no source")
    shutil.copytree(out, old)
    with atomic_dir(out, "marker") as folder:
        (folder / "marker").write_text("newer")
    assert list(tmp_path.iterdir()) == [out] and contents(out) == {"marker": "newer"}


def claiming(shape):
    """Return a .npy without numbers whose header claims some."""
    head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head.encode()


def test_a_false_claim_is_an_error(tmp_path):
    claim = claiming((12_500_000_000,))
    (tmp_path / "a.npy").write_bytes(claim)
    for mapped in (False, True):
        with pytest.raises(InputError, match=r"a\.npy: not a readable .npy"):
            read_array(tmp_path / "a.npy", mapped)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as file:
        file.writestr("poses.npy", claim)
    with pytest.raises(InputError, match=r"a\.npz: not a readable .npz \('poses': "):
        read_arrays(tmp_path / "a.npz", "poses")
    with zipfile.ZipFile(tmp_path / "b.npz", "w") as file:
        file.writestr("data.pkl", b"")
    with pytest.raises(InputError, match="it is not an array of numpy"):
        read_arrays(tmp_path / "b.npz", "poses")


def test_a_file_is_read_again_once_it_or_its_folder_has_changed(tmp_path):
    path, reads = tmp_path / "masks" / "0.txt", []

    @once_a_file
    def first(path, length):
        reads.append(path)
        return path.read_text()[:length]

    path.parent.mkdir()
    with pytest.raises(FileNotFoundError):
        first(path, 2)
    path.write_text("abc")
    reads.clear()
    assert [first(path, 2), first(path, 2), first(path, 1)] == ["ab", "ab", "a"]
    assert len(reads) == 2
    path.write_text("longer")
    assert first(path, 2) == "lo" and len(reads) == 3
    path.with_name("other").touch()
    os.utime(path.parent, (1, 1))  # whatever the clock's ticks
    assert first(path, 2) == "lo" and len(reads) == 4


def test_malformed_json_is_one_sentence(tmp_path):
    path = tmp_path / "a.json"
    for text in ("[" * 100_000, "{", '{"a": ' + "1" * 5000 + "}", "\x00"):
        path.write_text(text)
        with pytest.raises(InputError, match=r"a\.json: not readable as JSON \(.*\); expected b$"):
            read_json(path, "b")
    write_json(path, {"a": (1, 2), "b": path})
    assert read_json(path, "b") == {"a": [1, 2], "b": str(path)}
    with pytest.raises(InputError, match=r"b\.json: no such file; expected metrics"):
        read_json(tmp_path / "b.json", "metrics")


def test_malformed_content_is_one_short_sentence():
    assert str(InputError("a\x1b[2J\nb")) == "a [2J b"
    assert len(str(InputError("x" * 10**6))) < 2000
    for fails, reason in {
        (lambda: {}["x"]): "'x' is missing",
        (lambda: [][0]): "a value is missing",
        (lambda: next(iter(()))): "a value is missing",
        (lambda: None.a): "a value has the wrong type",
        (lambda: len(3)): "a value has the wrong type",
        (lambda: 1 / 0): "a number is zero or too large",
        (lambda: b"\xff".decode()): "it is not text in UTF-8",
        (lambda: np.zeros(3) + np.zeros(4)): "a list or an array has the wrong length",
        (lambda: np.zeros(3).reshape(2, 2)): "a list or an array has the wrong length",
    }.items():
        with pytest.raises(InputError) as error, expecting("a", "b"):
            fails()
        assert str(error.value) == f"a: unexpected format ({reason}); expected b"
    with pytest.raises(InputError, match="^mine$"), expecting("a", "b"):
        raise InputError("mine")
