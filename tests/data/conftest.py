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


@pytest.fixture(scope="session")
def tiny_sam(tmp_path_factory, one_thread):
    """A folder with a Segment Anything of 64 x 64 pixels that has learned to find ellipses.

    It is the real architecture in a small size, trained for some seconds on ellipses among others,
    prompted by a box, by points, and in every third step by a mask.
    """
    import torch

    transformers = pytest.importorskip("transformers")
    transformers.utils.logging.disable_progress_bar()
    torch.manual_seed(0)
    side, width = 64, 32
    vision = transformers.SamVisionConfig(
        hidden_size=width, num_hidden_layers=1, num_attention_heads=2, image_size=side,
        patch_size=4, window_size=0, global_attn_indexes=[0], output_channels=width, mlp_ratio=2.0,
        num_pos_feats=width // 2,
    )  # fmt: skip
    prompts = transformers.SamPromptEncoderConfig(
        hidden_size=width, image_size=side, patch_size=4, mask_input_channels=4
    )
    masks = transformers.SamMaskDecoderConfig(
        hidden_size=width, num_hidden_layers=1, num_attention_heads=2, mlp_dim=width,
        iou_head_hidden_dim=16,
    )  # fmt: skip
    config = transformers.SamConfig(
        vision_config=vision, prompt_encoder_config=prompts, mask_decoder_config=masks
    )
    network = transformers.SamModel(config).train()
    optimizer = torch.optim.Adam(network.parameters(), 3e-3)
    for step in range(90):
        images, boxes, points, truth = _ellipses(12, side)
        shown = (16 * truth - 8)[:, None] if step % 3 == 2 else None
        found = network(
            pixel_values=images, input_boxes=boxes, input_points=points, input_masks=shown,
            input_labels=torch.ones(points.shape[:3], dtype=torch.long),
        )  # fmt: skip
        guesses = found.pred_masks[:, 0]
        target = truth[:, None].expand_as(guesses)
        loss = torch.nn.functional.binary_cross_entropy_with_logits(guesses, target)
        both, either = ((guesses > 0) & (target > 0)), ((guesses > 0) | (target > 0))
        overlap = both.sum((2, 3)) / either.sum((2, 3)).clamp(min=1)
        loss = loss + 0.1 * ((found.iou_scores[:, 0] - overlap) ** 2).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    folder = tmp_path_factory.mktemp("sam")
    network.save_pretrained(folder)
    return folder


def _ellipses(count, side):
    """Pictures of a bright ellipse and a bright spot aside, a box and points, and the ellipse."""
    import torch

    y, x = torch.meshgrid(torch.arange(side) + 0.5, torch.arange(side) + 0.5, indexing="ij")
    images = 0.5 * torch.rand(count, 3, 1, 1) + 0.1 * torch.rand(count, 3, side, side)
    boxes, points, truth = [], [], []
    for image in images:
        centre, radii = 26 + 12 * torch.rand(2), 8 + 16 * torch.rand(2)
        inside = ((x - centre[0]) / radii[0]) ** 2 + ((y - centre[1]) / radii[1]) ** 2 < 1
        corner = torch.tensor([4.0, side - 4.0])[torch.randint(2, (2,))]
        image[:, (x - corner[0]).abs() + (y - corner[1]).abs() < 9] = 0.8 + 0.2 * torch.rand(3, 1)
        image[:, inside] = 0.8 + 0.2 * torch.rand(3, 1)
        low, high = centre - radii + 2 * torch.randn(2), centre + radii + 2 * torch.randn(2)
        boxes.append(torch.cat([low, high]))
        points.append(centre + radii * (torch.rand(4, 2) - 0.5))
        truth.append(inside.float())
    mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    images = (images - mean[:, None, None]) / std[:, None, None]
    return images, torch.stack(boxes)[:, None], torch.stack(points)[:, None], torch.stack(truth)


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
