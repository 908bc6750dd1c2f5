"""A tiny subject in the folder format, made of noise: three frames of 8 x 6 pixels."""

import numpy as np
import pytest

from gva_mi.body.pose import Pose, Shape, save_poses
from gva_mi.data.pictures import write_image
from gva_mi.data.video import save_cameras
from gva_mi.splat import Camera, look_at

WIDTH, HEIGHT, FRAMES = 8, 6, 3


@pytest.fixture
def subject(tmp_path):
    random = np.random.default_rng(0)
    folder = tmp_path / "subject"
    for k in range(FRAMES):
        frame = random.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
        mask = np.zeros((HEIGHT, WIDTH), np.uint8)
        mask[1:5, 2:6] = 255
        write_image(folder / f"frames/{k:06d}.png", frame)
        write_image(folder / f"masks/{k:06d}.png", mask)
    import torch

    save_poses(folder / "poses.npz", Pose.rest(FRAMES), Shape(torch.zeros(10)), stage=1)
    camera = Camera(10, 10, 4, 3, look_at((0, 0, 3), (0, 0, 0)), WIDTH, HEIGHT)
    save_cameras(folder / "cameras.npz", [camera] * FRAMES)
    return folder


def onnx_file(path, sides=("h", "w"), channels=3, kind="normals"):
    """Write a network whose x and y are what it is given in red and green; z closes them to one.

    Other kinds write (n + 1) / 2, x and y alone, vectors of length 0, or NaN.
    """
    nodes = [
        ("Slice", ["seen", "zero", "two", "one"], ["colour"], {}),
        ("Clip", ["colour", "least", "most"], ["xy"], {}),
        ("ReduceSumSquare", ["xy", "one"], ["square"], {"keepdims": 1}),
        ("Sub", ["unit", "square"], ["rest"], {}),
        ("Sqrt", ["rest"], ["z"], {}),
        ("Concat", ["xy", "z"], ["normals"], {"axis": 1}),
        ("Add", ["normals", "unit"], ["raised"], {}),
        ("Mul", ["raised", "half"], ["encoded"], {}),
        ("Sub", ["seen", "seen"], ["nothing"], {}),
        ("Div", ["nothing", "nothing"], ["unknown"], {}),
    ]
    number = np.float32
    constants = {
        "zero": [0], "two": [2], "one": [1], "least": number(-0.6), "most": number(0.6),
        "unit": number(1), "half": number(0.5),
    }  # fmt: skip
    return onnx_graph(path, nodes, {"seen": ("FLOAT", [1, channels, *sides])}, [kind], constants)


def onnx_graph(path, nodes, inputs, outputs, constants=()):
    """Write a network of nodes ``(operator, inputs, outputs, attributes)``.

    Inputs are ``name: (type, shape)``; outputs are names; constants are ``name: numbers``.
    """
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    make, number = onnx.helper, onnx.TensorProto
    known = lambda name, x: onnx.numpy_helper.from_array(np.array(x), name)
    graph = make.make_graph(
        [make.make_node(kind, given, made, **more) for kind, given, made, more in nodes], "normals",
        [make.make_tensor_value_info(name, getattr(number, kind), shape)
         for name, (kind, shape) in inputs.items()],
        [make.make_tensor_value_info(name, number.FLOAT, None) for name in outputs],
        [known(name, x) for name, x in dict(constants).items()],
    )  # fmt: skip
    opset = make.make_opsetid("", 18)
    onnx.save(make.make_model(graph, opset_imports=[opset], ir_version=9), path)
    return path


@pytest.fixture(scope="session")
def network_file():
    """The function :func:`onnx_graph`."""
    return onnx_graph


@pytest.fixture(scope="session")
def normal_network():
    """The function :func:`onnx_file`."""
    return onnx_file
