"""Small networks in ``.onnx`` files: of normals, and of any nodes."""

import numpy as np
import pytest


def onnx_file(path, sides=("h", "w"), channels=3, kind="normals"):
    """Write a network whose x and y are what it is given in red and green; z closes them to one.

    Other kinds write (n + 1) / 2, x and y alone, vectors of length 0, or NaN.
    """
    nodes = [("Slice", ["seen", "zero", "two", "one"], ["colour"], {}),
        ("Clip", ["colour", "least", "most"], ["xy"], {}),
        ("ReduceSumSquare", ["xy", "one"], ["square"], {"keepdims": 1}),
        ("Sub", ["unit", "square"], ["rest"], {}), ("Sqrt", ["rest"], ["z"], {}),
        ("Concat", ["xy", "z"], ["normals"], {"axis": 1}),
        ("Add", ["normals", "unit"], ["raised"], {}), ("Mul", ["raised", "half"], ["encoded"], {}),
        ("Sub", ["seen", "seen"], ["nothing"], {}),
        ("Div", ["nothing", "nothing"], ["unknown"], {})]  # fmt: skip
    number = np.float32
    constants = {"zero": [0], "two": [2], "one": [1], "least": number(-0.6), "most": number(0.6),
        "unit": number(1), "half": number(0.5)}  # fmt: skip
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
