"""An avatar file without its body holds nothing of the body, and is complete with it."""

import numpy as np
import pytest
import torch

from gva_mi import InputError
from gva_mi.avatar.avatar import Avatar, AvatarOptions, seed_avatar
from gva_mi.avatar.canonical import SeedOptions
from gva_mi.avatar.residual import ResidualOptions
from gva_mi.avatar.without_body import body_hash, save_without_body, with_body
from gva_mi.body.pose import Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.files import read_arrays

OWN = {  # what of an avatar is not its body's
    "format", "description", "light", "betas", "offsets", "beneath", "shares",
    "canonical.means", "canonical.quats", "canonical.log_scales", "canonical.logit_opacities",
    "canonical.sh", "canonical.weights", "canonical.slopes",
}  # fmt: skip


@pytest.fixture
def clothed(body):
    """An avatar in loose clothes, its Gaussians moved off the surface, with a residual."""
    generator = torch.Generator().manual_seed(2)
    offsets = 0.05 * torch.rand(body.v_template.shape, generator=generator)
    options = AvatarOptions(seed=SeedOptions(count=300), residual=ResidualOptions(enabled=True))
    avatar = seed_avatar(body, Shape(torch.linspace(-1, 1, 10)), offsets, options, generator)
    with torch.no_grad():
        avatar.canonical.means += 0.01
        avatar.residual.offset.weight.normal_(generator=generator)
        avatar.light.copy_(torch.tensor([0.1, 0.9, 0.3]))
    avatar.rebind_weights()
    return avatar


@pytest.fixture
def file(clothed, body, tmp_path):
    save_without_body(tmp_path / "a.npz", clothed, body, "ellipsoid")
    return tmp_path / "a.npz"


def test_with_its_body_it_moves_as_before(file, clothed, body, random_pose):
    again = with_body(file, read_arrays(file, ""), body, "ellipsoid")
    for seed in (0, 1):
        pose = random_pose(seed)
        pose.expression[:] = torch.randn(1, 10, generator=torch.Generator().manual_seed(seed))
        one, two = again(pose), clothed(pose)
        for name, value in two.arrays().items():
            assert torch.allclose(getattr(one, name), value, atol=1e-5), name
    assert torch.allclose(again.rig.vertices, clothed.rig.vertices, atol=1e-6)
    assert torch.equal(again.rig.faces, clothed.rig.faces)


def test_nothing_of_the_body_is_in_the_file(file, clothed, body):
    arrays = read_arrays(file, "")
    residual = {f"residual.{name}" for name in clothed.residual.state_dict()}
    assert arrays.keys() == OWN | residual
    rig, N, V = clothed.rig, 300, len(body.v_template)
    shapes = {name: array.shape for name, array in arrays.items()}
    assert [name for name, shape in shapes.items() if V in shape] == ["offsets"]
    assert shapes["beneath"] == shapes["shares"] == (N, 7)
    assert np.allclose(arrays["offsets"], rig.vertices - body.rest(Shape(rig.betas)).vertices)
    assert '"name": "ellipsoid"' in str(arrays["description"])
    assert body_hash(body) in str(arrays["description"])


def test_no_body_and_another_body_are_refused(file, clothed, body, tmp_path):
    with pytest.raises(InputError, match="without its body"):
        Avatar.load(file)
    for part in ("shapedirs", "v_template"):
        arrays = body.arrays()
        arrays[part] = arrays[part] * 1.01
        other = BodyModel(arrays)
        with pytest.raises(InputError, match="belongs to 'ellipsoid' .* not to 'other'"):
            with_body(file, read_arrays(file, ""), other, "other")
    with pytest.raises(InputError, match="made with another body .* than other"):
        save_without_body(tmp_path / "b.npz", clothed, other, "other")
    assert not (tmp_path / "b.npz").exists()
