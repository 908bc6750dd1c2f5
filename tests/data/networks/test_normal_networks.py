"""Networks of normals in files that the tests write: their input and output."""

import warnings

import numpy as np
import pytest
import torch

from gva_mi.core.errors import InputError
from gva_mi.data.networks.normals import NormalNetwork, NormalsSpec

SIZE = (24, 32)


class FromColour(torch.nn.Module):
    """Normals whose x and y are what it is given in red and green; z closes them to unit length."""

    def __init__(self, encoded=False):
        super().__init__()
        self.encoded = encoded

    def forward(self, seen: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        xy = seen[:, :2].clamp(-0.6, 0.6)
        z = (1 - (xy * xy).sum(1, keepdim=True)).sqrt()
        normals = torch.cat([xy, z], dim=1)
        if self.encoded:
            normals = (normals + 1) / 2
        return normals, seen


def torch_script(path, network):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.jit.save(torch.jit.script(network), path)
    return path


def onnx_file(path, sides=("h", "w"), channels=3):
    """The same arithmetic as an ONNX graph."""
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    make, number = onnx.helper, onnx.TensorProto
    constant = lambda name, values, kind=number.INT64: make.make_tensor(
        name, kind, [len(values)], values
    )
    nodes = [
        make.make_node("Slice", ["seen", "zero", "two", "one"], ["colour"]),
        make.make_node("Clip", ["colour", "least", "most"], ["xy"]),
        make.make_node("ReduceSumSquare", ["xy", "one"], ["square"], keepdims=1),
        make.make_node("Sub", ["unit", "square"], ["rest"]),
        make.make_node("Sqrt", ["rest"], ["z"]),
        make.make_node("Concat", ["xy", "z"], ["normals"], axis=1),
    ]
    scalar = lambda name, x: make.make_tensor(name, number.FLOAT, [], [x])
    graph = make.make_graph(
        nodes, "normals",
        [make.make_tensor_value_info("seen", number.FLOAT, [1, channels, *sides])],
        [make.make_tensor_value_info("normals", number.FLOAT, [1, 3, *sides])],
        [constant("zero", [0]), constant("two", [2]), constant("one", [1]),
         scalar("least", -0.6), scalar("most", 0.6), scalar("unit", 1.0)],
    )  # fmt: skip
    opset = make.make_opsetid("", 18)
    onnx.save(make.make_model(graph, opset_imports=[opset], ir_version=9), path)
    return path


@pytest.fixture
def person():
    """A picture (60, 80, 3) that darkens to the right and to the bottom, and a mask in it."""
    y, x = np.mgrid[:60, :80]
    image = np.stack([255 - 2 * x, 200 - y, 0 * x + 90], axis=-1).astype(np.uint8)
    mask = np.zeros((60, 80), np.float32)
    mask[10:50, 30:50] = 1
    return image, mask, np.array([30.0, 10, 50, 50])


@pytest.mark.parametrize("form", ["script", "encoded", "onnx", "onnx of one size"])
def test_the_network_s_input_and_output_are_in_its_convention(form, person, tmp_path):
    """Red 170, as in the middle of the person, is (170/255 − 0.5) / 0.5 for the network."""
    if form.startswith("onnx"):
        sides = SIZE[::-1] if "size" in form else ("h", "w")
        path = onnx_file(tmp_path / "normals.onnx", sides)
    else:
        path = torch_script(tmp_path / "normals.pt", FromColour(form == "encoded"))
    asked = (64, 64) if "size" in form else SIZE  # the file's own size is what counts
    network = NormalNetwork(path, NormalsSpec("perspective", asked))
    crop, normals = network.see(*person)
    assert crop.width * SIZE[1] == pytest.approx(crop.height * SIZE[0], rel=0.05)
    assert crop.top <= 10 - 4 and crop.top + crop.height >= 50 + 4
    assert normals.shape == (SIZE[1], SIZE[0], 3)
    assert np.abs(np.linalg.norm(normals, axis=-1) - 1).max() < 1e-5
    place = crop.to_network(np.array([40.0, 30.0]), SIZE).astype(int)
    red, green = person[0][30, 40, :2] / 127.5 - 1
    assert np.abs(normals[place[1], place[0], :2] - (red, green)).max() < 0.04


def test_with_icon_the_background_is_the_mean(person, tmp_path):
    path = torch_script(tmp_path / "normals.pt", FromColour())
    _, whole = NormalNetwork(path, NormalsSpec("opengl", SIZE)).see(*person)
    _, alone = NormalNetwork(path, NormalsSpec("icon", SIZE)).see(*person)
    assert np.abs(whole[16, 1, 0]) > 0.3 and np.abs(alone[16, 1, :2]).max() < 0.01
    assert np.allclose(alone[16, 12], whole[16, 12], atol=0.02)
    mean = NormalsSpec("perspective", SIZE, (0.4, 0.4, 0.4), (0.25, 0.25, 0.25))
    _, shifted = NormalNetwork(path, mean).see(*person)
    green = person[0][30, 40, 1] / 255
    assert shifted[16, 12, 1] == pytest.approx(min(0.6, (green - 0.4) / 0.25), abs=0.05)


class Wrong(torch.nn.Module):
    def __init__(self, kind: str):
        super().__init__()
        self.kind = kind

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        if self.kind == "two":
            return seen[:, :2]
        if self.kind == "zero":
            return seen * 0 - 0.01
        if self.kind == "unknown":
            return seen * float("nan")
        return torch.cat([seen, seen], dim=2).reshape(7)


def test_a_bad_network_is_refused_in_one_sentence(person, tmp_path):
    def refused(path, words):
        with pytest.raises(InputError, match=words) as error:
            NormalNetwork(path, NormalsSpec("icon", SIZE)).see(*person)
        assert "\n" not in str(error.value) and "expected" in str(error.value)

    refused(tmp_path / "none.pt", "no such network of normals")
    (tmp_path / "text.pt").write_text("hello")
    refused(tmp_path / "text.pt", "no TorchScript")
    torch.save({"weights": torch.zeros(3)}, tmp_path / "weights.pt")
    refused(tmp_path / "weights.pt", "no TorchScript")
    (tmp_path / "text.txt").write_text("hello")
    refused(tmp_path / "text.txt", "expected a file .pt")
    for kind, words in (
        ("two", r"answers with float32 \(1, 2, 32, 24\)"), ("zero", "which are no normals"),
        ("unknown", "which are no normals"), ("other", "fails"),
    ):  # fmt: skip
        refused(torch_script(tmp_path / f"{kind}.pt", Wrong(kind)), words)


def test_a_bad_onnx_network_is_refused_in_one_sentence(person, tmp_path):
    pytest.importorskip("onnxruntime")
    (tmp_path / "text.onnx").write_text("hello")
    with pytest.raises(InputError, match="no ONNX network .*expected a network that takes"):
        NormalNetwork(tmp_path / "text.onnx", NormalsSpec("icon"))
    many = NormalNetwork(onnx_file(tmp_path / "many.onnx", channels=5), NormalsSpec("icon", SIZE))
    with pytest.raises(InputError, match="many.onnx: fails .*expected a network that takes"):
        many.see(*person)
