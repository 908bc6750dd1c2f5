"""``gva-mi body``: what it writes, and what it refuses."""

import importlib
import pickle

import numpy as np
import pytest

from gva_mi.body.built_in import BUILT_IN_BODY
from gva_mi.cli.body import body
from gva_mi.core.errors import InputError


@pytest.fixture(autouse=True)
def blank_pictures(monkeypatch):
    blank = lambda *_, **__: np.ones((4, 8, 3), np.float32)
    module = importlib.import_module("gva_mi.cli.body")
    monkeypatch.setattr(module, "turntable", blank)
    monkeypatch.setattr(module, "draw_sheet", blank)


def test_it_writes_the_body_and_its_pictures(tmp_path, capsys, monkeypatch):
    out, sheet = tmp_path / "a" / "body.npz", tmp_path / "sheet.png"
    body(out=out, sheet=sheet)
    written = capsys.readouterr().out.split()
    assert written == [str(out), str(out.with_suffix(".png")), str(sheet)]
    assert out.read_bytes() == BUILT_IN_BODY.read_bytes()
    assert sheet.exists() and out.with_suffix(".png").exists()
    with pytest.raises(InputError, match="body.npz: exists already; give --overwrite"):
        body(out=out)
    body(source=str(out), out=out, overwrite=True)
    assert out.read_bytes() == BUILT_IN_BODY.read_bytes()
    monkeypatch.chdir(tmp_path / "a")
    body()
    assert (tmp_path / "a/puppet.png").exists()


def test_bodies_it_cannot_copy_are_named(tmp_path):
    with pytest.raises(InputError, match="nobody.npz: no such file"):
        body(source=str(tmp_path / "nobody.npz"))
    with pytest.raises(InputError, match="a body file ends in .npz"):
        body(out=tmp_path / "body.pkl")
    with np.load(BUILT_IN_BODY) as file:
        (tmp_path / "body.pkl").write_bytes(pickle.dumps(dict(file)))
    with pytest.raises(InputError, match="body.pkl: --out copies a file, expected"):
        body(source=str(tmp_path / "body.pkl"), out=tmp_path / "body.npz")
    assert not (tmp_path / "body.npz").exists()
