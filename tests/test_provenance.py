"""Digests and hashes change with what they are of, and with nothing else."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import gva_mi
from gva_mi.core import provenance
from gva_mi.core.provenance import hash_arrays, program_digest


def test_the_digest_of_the_program_changes_with_its_code(tmp_path, monkeypatch):
    copy = shutil.copytree(Path(gva_mi.__file__).parent / "core", tmp_path / "core")
    place = lambda _: SimpleNamespace(submodule_search_locations=[str(copy)])
    monkeypatch.setattr(provenance, "find_spec", place)
    digest = program_digest.__wrapped__
    first = digest()
    assert first == digest()
    (copy / "errors.py").write_text("raise SystemExit\n")
    assert first != digest()


def test_a_hash_of_arrays_sees_values_shapes_and_types():
    arrays = ([1.0, 2.0], "words")
    assert hash_arrays(arrays) == hash_arrays(iter(arrays))
    for other in (([1.0, 3.0], "words"), ([[1.0, 2.0]], "words"), ([1, 2], "words")):
        assert hash_arrays(other) != hash_arrays(arrays)
