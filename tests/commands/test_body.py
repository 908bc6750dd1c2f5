"""``gva-mi body``: what it writes, and what it refuses."""

import importlib
import pickle

import numpy as np
import pytest

from gva_mi.body.puppet import PUPPET
from gva_mi.commands.body import body
from gva_mi.errors import InputError


@pytest.fixture
def quick(monkeypatch):
    blank = lambda *_, **__: np.ones((4, 8, 3), np.float32)
    module = importlib.import_module("gva_mi.commands.body")
    monkeypatch.setattr(module, "turntable", blank)
    monkeypatch.setattr(module, "draw_sheet", blank)


def test_the_command_writes_the_body_and_its_pictures(quick, tmp_path, capsys):
    out, sheet = tmp_path / "a" / "body.npz", tmp_path / "sheet.png"
    body(out=out, sheet=sheet)
    written = capsys.readouterr().out.split()
    assert written == [str(out), str(out.with_suffix(".png")), str(sheet)]
    assert out.read_bytes() == PUPPET.read_bytes()
    assert sheet.exists() and out.with_suffix(".png").exists()
    with pytest.raises(InputError, match="body.npz: exists already; give --overwrite"):
        body(out=out)
    body(source=str(out), out=out, overwrite=True)
    assert out.read_bytes() == PUPPET.read_bytes()


def test_without_a_place_the_picture_lies_here(quick, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    body()
    assert [path.name for path in tmp_path.iterdir()] == ["puppet.png"]


def test_a_body_that_is_not_there_is_named(quick, tmp_path):
    with pytest.raises(InputError, match="nobody.npz: no such file"):
        body(source=str(tmp_path / "nobody.npz"))
    with pytest.raises(InputError, match="a body file ends in .npz"):
        body(out=tmp_path / "body.pkl")


def test_a_pickled_body_is_not_copied_under_another_name(quick, tmp_path):
    with np.load(PUPPET) as file:
        (tmp_path / "body.pkl").write_bytes(pickle.dumps(dict(file)))
    with pytest.raises(InputError, match="body.pkl: --out copies a file, expected"):
        body(source=str(tmp_path / "body.pkl"), out=tmp_path / "body.npz")
    assert not (tmp_path / "body.npz").exists()
