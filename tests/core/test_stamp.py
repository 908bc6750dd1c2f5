"""A stamp changes with all that a result depends on, and with nothing else."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch

from gva_mi.core.stamp import is_fresh, stamp, start_folder, write_record


@dataclass(frozen=True)
class Options:
    steps: int = 3
    body: Path = Path("a.npz")


@pytest.fixture
def made(tmp_path):
    """Return a stamp of a file, a folder, numbers and options, each of which changes it."""

    def of(text="one", name="a.txt", moved="subject", number=1.0, steps=3, version=1):
        folder = tmp_path / moved / "masks"
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.iterdir():
            old.unlink()
        (folder / name).write_text(text)
        inputs = [folder, folder / name, np.array([number, 2.0]), "words", 7]
        return stamp(inputs, [Options(steps)], version)

    return of


@pytest.mark.parametrize("change", (
    {"text": "two"}, {"name": "b.txt"}, {"number": 1.5}, {"steps": 4}, {"version": 2},
))  # fmt: skip
def test_whatever_a_result_depends_on_changes_the_stamp(change, made):
    assert made() == made(moved="elsewhere")
    assert made() != made(**change)


def test_shape_and_dtype_of_an_array_count_and_its_library_does_not():
    two = stamp([[1.0, 2.0]])
    assert two == stamp(iter([torch.tensor([1.0, 2.0], dtype=torch.float64)]))
    assert len({two, stamp([1.0, 2.0]), stamp([[[1.0, 2.0]]]), stamp([[1, 2]]), stamp()}) == 5


def test_a_missing_file_is_no_empty_one(tmp_path):
    gone = stamp([tmp_path / "a"])
    (tmp_path / "a").touch()
    assert gone != stamp([tmp_path / "a"])


def test_a_result_is_fresh_if_its_record_holds_the_stamp(tmp_path):
    path = tmp_path / "made.json"
    assert not is_fresh(path, "1")
    write_record(path, {"options": Options()}, "1")
    assert is_fresh(path, "1") and not is_fresh(path, "2")
    start_folder(tmp_path, "made.json", True, {})
    assert not is_fresh(path, "1")
    for text in ("[]", "{"):
        path.write_text(text)
        assert not is_fresh(path, "1")
