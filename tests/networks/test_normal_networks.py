"""Networks of normals in files that the tests write: their input and output."""

import numpy as np
import pytest
from samples.networks import onnx_file, onnx_graph

from gva_mi.core.errors import InputError
from gva_mi.networks.normals import NormalNetwork, NormalsSpec

SIZE = (24, 32)


@pytest.fixture
def person():
    """A picture (60, 80, 3) that darkens to the right and to the bottom, and a mask in it."""
    y, x = np.mgrid[:60, :80]
    image = np.stack([255 - 2 * x, 200 - y, 0 * x + 90], axis=-1).astype(np.uint8)
    mask = np.zeros((60, 80), np.float32)
    mask[10:50, 30:50] = 1
    return image, mask, np.array([30.0, 10, 50, 50])


@pytest.mark.parametrize("kind", ["normals", "encoded"])
@pytest.mark.parametrize("sides", [("h", "w"), SIZE[::-1]])
def test_the_network_s_input_and_output_are_in_its_convention(kind, sides, person, tmp_path):
    """Red 170, as in the middle of the person, is (170/255 − 0.5) / 0.5 for the network."""
    path = onnx_file(tmp_path / "normals.onnx", sides, kind=kind)
    asked = SIZE if sides == ("h", "w") else (64, 64)  # the file's own size is what counts
    crop, normals = NormalNetwork(path, NormalsSpec("perspective", asked)).see(*person)
    assert crop.width * SIZE[1] == pytest.approx(crop.height * SIZE[0], rel=0.05)
    assert crop.top <= 10 - 4 and crop.top + crop.height >= 50 + 4
    assert normals.shape == (SIZE[1], SIZE[0], 3)
    assert np.abs(np.linalg.norm(normals, axis=-1) - 1).max() < 1e-5
    place = crop.to_network(np.array([40.0, 30.0]), SIZE).astype(int)
    red, green = person[0][30, 40, :2] / 127.5 - 1
    assert np.abs(normals[place[1], place[0], :2] - (red, green)).max() < 0.04


def test_with_icon_the_background_is_the_mean(person, tmp_path):
    path = onnx_file(tmp_path / "normals.onnx")
    _, whole = NormalNetwork(path, NormalsSpec("opengl", SIZE)).see(*person)
    _, alone = NormalNetwork(path, NormalsSpec("icon", SIZE)).see(*person)
    assert np.abs(whole[16, 1, 0]) > 0.3 and np.abs(alone[16, 1, :2]).max() < 0.01
    assert np.allclose(alone[16, 12], whole[16, 12], atol=0.02)
    mean = NormalsSpec("perspective", SIZE, (0.4, 0.4, 0.4), (0.25, 0.25, 0.25))
    _, shifted = NormalNetwork(path, mean).see(*person)
    green = person[0][30, 40, 1] / 255
    assert shifted[16, 12, 1] == pytest.approx(min(0.6, (green - 0.4) / 0.25), abs=0.05)


def test_one_of_several_outputs_is_chosen_by_its_name(person, tmp_path):
    """A file of MoGe-2's form: numbers of patches in, normals (1, h, w, 3) beside other arrays.

    24 by 32 pixels hold 3.9 patches of 14 by 14: its input is 4, and it answers x = 0.4, y = 0.
    """
    nodes = [("Cast", ["num_tokens"], ["tokens"], {"to": 1}),
        ("Mul", ["tokens", "tenth"], ["x"], {}), ("Mul", ["image", "nothing"], ["zero"], {}),
        ("Split", ["zero"], ["r", "g", "b"], {"axis": 1, "num_outputs": 3}),
        ("Add", ["r", "x"], ["x_map"], {}), ("Sub", ["b", "height"], ["z_map"], {}),
        ("Concat", ["x_map", "g", "z_map"], ["planes"], {"axis": 1}),
        ("Transpose", ["planes"], ["normal"], {"perm": [0, 2, 3, 1]}),
        ("Transpose", ["image"], ["points"], {"perm": [0, 2, 3, 1]})]  # fmt: skip
    path = onnx_graph(
        tmp_path / "scene.onnx", nodes,
        {"image": ("FLOAT", [1, 3, "h", "w"]), "num_tokens": ("INT64", [])}, ["points", "normal"],
        {"tenth": np.float32(0.1), "nothing": np.float32(0), "height": np.float32(0.84**0.5)},
    )  # fmt: skip
    _, normals = NormalNetwork(path, NormalsSpec("perspective", SIZE)).see(*person)
    assert np.allclose(normals, (0.4, 0, -(0.84**0.5)), atol=1e-6)
    with pytest.raises(InputError, match="has the outputs points, normal; expected one output, or"):
        NormalNetwork(path, NormalsSpec("perspective", SIZE, output="normals"))


def test_a_bad_network_is_refused_in_one_sentence(person, tmp_path):
    def refused(path, words):
        with pytest.raises(InputError, match=words) as error:
            NormalNetwork(path, NormalsSpec("icon", SIZE)).see(*person)
        assert "expected" in str(error.value)

    refused(tmp_path / "none.onnx", "no such network of normals")
    for suffix, words in (("pt", "expected a file .onnx"), ("onnx", "no ONNX network ")):
        (tmp_path / f"text.{suffix}").write_text("hello")
        refused(tmp_path / f"text.{suffix}", words)
    many = onnx_file(tmp_path / "many.onnx", channels=5)
    refused(many, "many.onnx: fails .*expected a network that takes")
    for kind, words in (
        ("xy", r"answers with float32 \(1, 2, 32, 24\)"), ("nothing", "which are no normals"),
        ("unknown", "which are no normals"),
    ):  # fmt: skip
        refused(onnx_file(tmp_path / f"{kind}.onnx", kind=kind), words)
