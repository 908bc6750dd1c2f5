"""Read the weights of Segment Anything or SAM 2: a folder as ``transformers`` saves it.

Such as ``facebook/sam-vit-base`` or ``facebook/sam2.1-hiera-tiny`` of the Hugging Face hub:
``config.json`` and ``model.safetensors``, which holds arrays alone.
"""

from __future__ import annotations

from pathlib import Path

import torch

from gva_mi.core.errors import InputError
from gva_mi.core.files import read_json

GET = (
    "a folder as transformers saves it (config.json, model.safetensors), such as "
    "facebook/sam-vit-base or facebook/sam2.1-hiera-tiny of the Hugging Face hub"
)
MODELS = {"sam": "SamModel", "sam2": "Sam2Model", "sam2_video": "Sam2Model"}  # by config.json


def load_network(path: Path) -> torch.nn.Module:
    """Read a checkpoint's network, ready to be called.

    Raises:
        InputError: nothing is there, the package is missing, or it is of another form.
    """
    if not path.is_dir():
        what = "is a file" if path.exists() else "no such checkpoint of Segment Anything"
        raise InputError(f"{path}: {what}; expected {GET}")
    try:
        import transformers
    except ModuleNotFoundError:
        raise InputError(
            f"{path}: masks by Segment Anything need the package transformers; "
            "pip install 'gva_mi[sam]'"
        ) from None
    transformers.utils.logging.set_verbosity_error()
    transformers.utils.logging.disable_progress_bar()
    about = read_json(path / "config.json", GET)
    kind = about.get("model_type") if isinstance(about, dict) else None
    if not isinstance(kind, str) or kind not in MODELS:
        raise InputError(f"{path}: holds a network of the kind {kind}; expected {GET}")
    try:
        network = getattr(transformers, MODELS[kind]).from_pretrained(
            path, local_files_only=True, use_safetensors=True, dtype=torch.float32
        )
    except Exception as error:  # noqa: BLE001 (safetensors and transformers have their own)
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: cannot be read ({reason:.120}); expected {GET}") from None
    return network.eval().requires_grad_(False)
