"""Good files of networks that users bring, as in seeds.py."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from gva_mi.data.networks.normals import NormalNetwork, NormalsSpec
from gva_mi.data.networks.segment_anything import load_network

THERE = Path(__file__).parents[1] / "data"


def networks():
    """All of them by name."""
    return {"sam": (sam, lambda folder, _=None: load_network(folder)), "onnx": (onnx, read_onnx)}


def sam(folder):
    transformers = pytest.importorskip("transformers")
    vision = transformers.SamVisionConfig(
        hidden_size=16, num_hidden_layers=3, num_attention_heads=2, image_size=32, patch_size=8,
        window_size=2, global_attn_indexes=[1], output_channels=16, mlp_ratio=2.0, num_pos_feats=8,
    )  # fmt: skip
    prompts = transformers.SamPromptEncoderConfig(
        hidden_size=16, image_size=32, patch_size=8, mask_input_channels=8
    )
    masks = transformers.SamMaskDecoderConfig(hidden_size=16, mlp_dim=32, iou_head_hidden_dim=12)
    parts = {"vision_config": vision, "prompt_encoder_config": prompts}
    config = transformers.SamConfig(**parts, mask_decoder_config=masks)
    transformers.SamModel(config).save_pretrained(folder)


def onnx(folder):
    runpy.run_path(str(THERE / "conftest.py"))["onnx_file"](folder / "a.onnx", (16, 16))


def read_onnx(folder, _=None):
    mask = np.zeros((24, 32), np.float32)
    mask[4:20, 8:24] = 1
    network = NormalNetwork(folder / "a.onnx", NormalsSpec("icon", (16, 16)))
    network.see(np.full((24, 32, 3), 99, np.uint8), mask, np.array([8.0, 4, 24, 20]))
