"""``gva-mi body``: what it writes, and what it refuses."""

import pytest

from gva_mi.body.body_file import BUILT_IN_BODY
from gva_mi.cli.avatar import body
from gva_mi.core.errors import InputError


def test_it_writes_the_body(tmp_path, capsys, monkeypatch):
    out = tmp_path / "a" / "body.npz"
    body(out=out)
    assert capsys.readouterr().out.split() == [str(out)]
    assert out.read_bytes() == BUILT_IN_BODY.read_bytes()
    with pytest.raises(InputError, match="body.npz: exists already; give --overwrite"):
        body(out=out)
    body(out=out, overwrite=True)
    monkeypatch.chdir(tmp_path / "a")
    body()
    assert (tmp_path / "a/built-in.npz").read_bytes() == BUILT_IN_BODY.read_bytes()
    with pytest.raises(InputError, match="a body file ends in .npz"):
        body(out=tmp_path / "body.pkl")
