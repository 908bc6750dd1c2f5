"""The files that the weights of Segment Anything come in, as one network of ``transformers``.

======================================  ====================================================
A folder, as ``transformers`` saves it  ``config.json`` and ``model.safetensors``, such as of
                                        ``facebook/sam-vit-base`` or
                                        ``facebook/sam2.1-hiera-tiny``
A ``.pth`` of Meta's                    ``sam_vit_b_01ec64.pth`` and its larger sisters; the
                                        sizes of the network are read off the arrays
======================================  ====================================================

Both hold arrays alone: a pickle that would run code is refused.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import torch

from gva_mi.errors import InputError
from gva_mi.files import read_json

GET = (
    "a folder as transformers saves it (config.json, model.safetensors), such as "
    "facebook/sam-vit-base or facebook/sam2.1-hiera-tiny of the Hugging Face hub, or Meta's "
    "sam_vit_b_01ec64.pth of github.com/facebookresearch/segment-anything"
)
MODELS = {"sam": "SamModel", "sam2": "Sam2Model", "sam2_video": "Sam2Model"}  # by config.json
_HEADS = 8  # of the decoder's attention, which no array tells
# Meta's names, in this order, as transformers has them.
_RENAMES = (
    (r"^image_encoder\.", "vision_encoder."),
    (r"\.patch_embed\.proj\.", ".patch_embed.projection."),
    (r"\.blocks\.(\d+)\.norm(\d)\.", r".layers.\1.layer_norm\2."),
    (r"\.blocks\.", ".layers."),
    (r"\.neck\.0\.", ".neck.conv1."), (r"\.neck\.1\.", ".neck.layer_norm1."),
    (r"\.neck\.2\.", ".neck.conv2."), (r"\.neck\.3\.", ".neck.layer_norm2."),
    (r"\.pe_layer\.positional_encoding_gaussian_matrix$",
     ".shared_embedding.positional_embedding"),
    (r"\.point_embeddings\.", ".point_embed."),
    (r"\.mask_downscaling\.0\.", ".mask_embed.conv1."),
    (r"\.mask_downscaling\.1\.", ".mask_embed.layer_norm1."),
    (r"\.mask_downscaling\.3\.", ".mask_embed.conv2."),
    (r"\.mask_downscaling\.4\.", ".mask_embed.layer_norm2."),
    (r"\.mask_downscaling\.6\.", ".mask_embed.conv3."),
    (r"\.norm(\d)\.", r".layer_norm\1."),
    (r"\.norm_final_attn\.", ".layer_norm_final_attn."),
    (r"\.output_upscaling\.0\.", ".upscale_conv1."),
    (r"\.output_upscaling\.1\.", ".upscale_layer_norm."),
    (r"\.output_upscaling\.3\.", ".upscale_conv2."),
    (r"(output_hypernetworks_mlps\.\d+|iou_prediction_head)\.layers\.0\.", r"\1.proj_in."),
    (r"(output_hypernetworks_mlps\.\d+|iou_prediction_head)\.layers\.1\.", r"\1.layers.0."),
    (r"(output_hypernetworks_mlps\.\d+|iou_prediction_head)\.layers\.2\.", r"\1.proj_out."),
)  # fmt: skip


def load_network(path: Path) -> torch.nn.Module:
    """The network of a checkpoint, ready to be asked.

    Raises:
        InputError: nothing is there, the package is missing, or it is of another form.
    """
    if not path.exists():
        raise InputError(f"{path}: no such checkpoint of Segment Anything; expected {GET}")
    try:
        import transformers
    except ModuleNotFoundError:
        raise InputError(
            f"{path}: masks by Segment Anything need the package transformers; "
            "pip install 'gva_mi[sam]'"
        ) from None
    transformers.utils.logging.set_verbosity_error()
    transformers.utils.logging.disable_progress_bar()
    network = _of_folder(path, transformers) if path.is_dir() else _of_meta(path, transformers)
    return network.eval().requires_grad_(False)


def _of_folder(path: Path, transformers: Any) -> torch.nn.Module:  # noqa: ANN401
    about = read_json(path / "config.json", GET)
    kind = about.get("model_type") if isinstance(about, dict) else None
    if not isinstance(kind, str) or kind not in MODELS:
        raise InputError(f"{path}: holds a network of the kind {kind}; expected {GET}")
    try:
        return getattr(transformers, MODELS[kind]).from_pretrained(
            path, local_files_only=True, use_safetensors=True, dtype=torch.float32
        )
    except Exception as error:  # noqa: BLE001 (safetensors and transformers have their own)
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: cannot be read ({reason:.120}); expected {GET}") from None


def _of_meta(path: Path, transformers: Any) -> torch.nn.Module:  # noqa: ANN401
    try:
        arrays = torch.load(path, map_location="cpu", weights_only=True)
        arrays = arrays.get("model", arrays)
        network = transformers.SamModel(_config_of(arrays, transformers))
        renamed = {_renamed(name): x for name, x in arrays.items()}
        # One array stands in two places.
        shared = renamed["prompt_encoder.shared_embedding.positional_embedding"]
        renamed["shared_image_embedding.positional_embedding"] = shared
        network.load_state_dict(renamed)
    except Exception as error:  # noqa: BLE001 (torch, pickle and transformers have their own)
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"{path}: no weights of Segment Anything ({reason:.120}); expected {GET}"
        ) from None
    return network


def _renamed(name: str) -> str:
    for pattern, instead in _RENAMES:
        name = re.sub(pattern, instead, name)
    return name


def _config_of(arrays: dict[str, torch.Tensor], transformers: Any) -> Any:  # noqa: ANN401
    """The sizes of the network that the arrays belong to."""
    shape = lambda name: tuple(arrays[name].shape)
    depth = lambda prefix: (
        1 + max(int(m[1]) for m in (re.match(rf"{prefix}\.(\d+)\.", name) for name in arrays) if m)
    )
    encoder, decoder = "image_encoder.blocks", "mask_decoder.transformer.layers"
    hidden, _, _, patch = shape("image_encoder.patch_embed.proj.weight")
    grid = shape("image_encoder.pos_embed")[1]
    # A block that looks at a window of w patches has 2 w - 1 relative places, others those of all.
    places = [shape(f"{encoder}.{k}.attn.rel_pos_h") for k in range(depth(encoder))]
    whole = [k for k, (count, _) in enumerate(places) if count == 2 * grid - 1]
    windows = [(count + 1) // 2 for count, _ in places if count != 2 * grid - 1]
    embedded = shape("image_encoder.neck.0.weight")[0]
    vision = transformers.SamVisionConfig(
        hidden_size=hidden, patch_size=patch, image_size=grid * patch, output_channels=embedded,
        num_hidden_layers=len(places), num_attention_heads=hidden // places[0][1],
        mlp_dim=shape(f"{encoder}.0.mlp.lin1.weight")[0], num_pos_feats=embedded // 2,
        global_attn_indexes=whole, window_size=windows[0] if windows else 0,
    )  # fmt: skip
    prompts = transformers.SamPromptEncoderConfig(
        hidden_size=embedded, image_size=grid * patch, patch_size=patch,
        mask_input_channels=shape("prompt_encoder.mask_downscaling.3.weight")[0],
    )  # fmt: skip
    width = shape(f"{decoder}.0.cross_attn_token_to_image.q_proj.weight")[0]
    masks = transformers.SamMaskDecoderConfig(
        hidden_size=embedded, num_hidden_layers=depth(decoder), num_attention_heads=_HEADS,
        mlp_dim=shape(f"{decoder}.0.mlp.lin1.weight")[0],
        attention_downsample_rate=embedded // width,
        iou_head_hidden_dim=shape("mask_decoder.iou_prediction_head.layers.0.weight")[0],
    )  # fmt: skip
    return transformers.SamConfig(
        vision_config=vision, prompt_encoder_config=prompts, mask_decoder_config=masks
    )
