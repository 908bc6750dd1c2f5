"""Anny in SMPL-X's format."""

import sys

import pytest
import torch

from gva_mi.body.anny import FILE, anny_body
from gva_mi.body.pose import JOINTS, Shape
from gva_mi.body.smplx import load_body
from gva_mi.core.errors import InputError


def test_a_missing_package_is_explained_and_a_cached_body_needs_none(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "anny", None)
    with pytest.raises(InputError, match=r"pip install 'gva_mi\[anny\]'.*--source built-in"):
        anny_body(tmp_path)
    (tmp_path / FILE).write_bytes(b"")
    assert anny_body(tmp_path) == tmp_path / FILE


@pytest.mark.slow
def test_the_body_stands_in_the_t_pose(tmp_path):
    pytest.importorskip("anny")
    body = load_body(anny_body(tmp_path))
    rest = body.rest(Shape(torch.zeros(10)))
    at = dict(zip(JOINTS, rest.joints, strict=True))
    assert 1.5 < rest.vertices[:, 1].max() - rest.vertices[:, 1].min() < 2.0
    assert (rest.joints[0].abs() < 0.005).all()
    for side, sign in (("left", 1.0), ("right", -1.0)):
        chain = [at[f"{side}_{j}"] for j in ("shoulder", "elbow", "wrist", "middle1", "middle3")]
        for a, b in zip(chain[:-1], chain[1:], strict=True):
            assert sign * (b - a)[0] > 0.98 * (b - a).norm()
        across = at[f"{side}_pinky1"] - at[f"{side}_index1"]
        assert -across[2] > 0.9 * across.norm()  # palm down
    jaw = body.weights[:, JOINTS.index("jaw")]
    assert (jaw > 0.5).any() and (body.num_betas, body.num_expressions) == (10, 10)
