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
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    make, number = onnx.helper, onnx.TensorProto
    whole = lambda name, x: make.make_tensor(name, number.INT64, [1], [x])
    scalar = lambda name, x: make.make_tensor(name, number.FLOAT, [], [x])
    nodes = [
        make.make_node("Slice", ["seen", "zero", "two", "one"], ["colour"]),
        make.make_node("Clip", ["colour", "least", "most"], ["xy"]),
        make.make_node("ReduceSumSquare", ["xy", "one"], ["square"], keepdims=1),
        make.make_node("Sub", ["unit", "square"], ["rest"]),
        make.make_node("Sqrt", ["rest"], ["z"]),
        make.make_node("Concat", ["xy", "z"], ["normals"], axis=1),
        make.make_node("Add", ["normals", "unit"], ["raised"]),
        make.make_node("Mul", ["raised", "half"], ["encoded"]),
        make.make_node("Sub", ["seen", "seen"], ["nothing"]),
        make.make_node("Div", ["nothing", "nothing"], ["unknown"]),
    ]
    graph = make.make_graph(
        nodes, "normals",
        [make.make_tensor_value_info("seen", number.FLOAT, [1, channels, *sides])],
        [make.make_tensor_value_info(kind, number.FLOAT, None)],
        [whole("zero", 0), whole("two", 2), whole("one", 1), scalar("least", -0.6),
         scalar("most", 0.6), scalar("unit", 1.0), scalar("half", 0.5)],
    )  # fmt: skip
    opset = make.make_opsetid("", 18)
    onnx.save(make.make_model(graph, opset_imports=[opset], ir_version=9), path)
    return path


@pytest.fixture(scope="session")
def normal_network():
    """The function :func:`onnx_file`."""
    return onnx_file
