"""Segment the person by Segment Anything or SAM 2, prompted by a box and points of the body.

The network sees a square around the box at its own resolution, so that a small person in a large
picture fills its input. It proposes three masks. With the mask of the frame before as a prompt, it
proposes a fourth one. The proposal with the largest sum of these scores is taken:

* the overlap with the ground truth that the network itself predicts, in [0, 1];
* the share of the person's points inside, less the share of other people's;
* the share of the proposal that lies in the box;
* the overlap with the mask of the frame before, where there is one.

With the first score alone, a sleeve or a face would often win.

Weights are a folder as ``transformers`` saves it, such as ``facebook/sam2.1-hiera-tiny`` of the
Hugging Face hub: ``config.json`` and ``model.safetensors``, which holds arrays alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch.nn.functional import grid_sample, interpolate

from gva_mi.core.errors import InputError, reason_of
from gva_mi.core.files import read_json
from gva_mi.subject.crop import CropBox

EXPECTED_WEIGHTS = (
    "a folder as transformers saves it (config.json, model.safetensors), such as "
    "facebook/sam-vit-base or facebook/sam2.1-hiera-tiny of the Hugging Face hub"
)
# By config.json.
TRANSFORMERS_CLASSES = {"sam": "SamModel", "sam2": "Sam2Model", "sam2_video": "Sam2Model"}

# Of the box's longer side, on each side. Chosen: it shows what is around the person.
BOX_MARGIN = 0.15
# RGB in [0, 1] of ImageNet's pictures: the network's input is normalised by them.
_IMAGENET_MEAN, _IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
_FILL_COLOR = tuple(round(255 * x) for x in _IMAGENET_MEAN)  # 8-bit; zero after normalisation
_CERTAIN_LOGIT = 32.0  # chosen: beyond any logit; outside the last crop the mask is empty


@dataclass(frozen=True)
class Prompt:
    """Box and points on the person, in picture pixels; the first pixel's centre is at 0.5."""

    box: np.ndarray  # (4,) left, top, right, bottom
    points: np.ndarray  # (n, 2) on the person, or on others
    labels: np.ndarray  # (n,) 1: the person; 0: somebody else


@dataclass(frozen=True)
class MaskGuess:
    """A mask that the network found in a picture."""

    mask: np.ndarray  # (H, W) bool
    crop: CropBox
    logits: torch.Tensor  # (h, w) of the crop, above zero inside

    def seen_in(self, crop: CropBox) -> torch.Tensor:
        """Resample the logits (h, w) to another crop; outside this one the mask is empty."""
        size = self.logits.shape[0]
        centres = (np.arange(size) + 0.5) / size * crop.width
        x, y = centres + crop.left - self.crop.left, centres + crop.top - self.crop.top
        # grid_sample counts from −1 at one border to 1 at the other.
        place = np.stack(np.meshgrid(x, y), axis=-1) * (2 / self.crop.width) - 1
        grid = torch.from_numpy(place.astype(np.float32))[None]
        moved = grid_sample(self.logits[None, None] + _CERTAIN_LOGIT, grid, align_corners=False)
        return moved[0, 0] - _CERTAIN_LOGIT


class SegmentAnything:
    """A segmentation network that box and point prompts guide."""

    def __init__(self, network: torch.nn.Module) -> None:
        self.network = network
        side = int(network.config.prompt_encoder_config.image_size)
        self.size = (side, side)  # of its input, pixels

    @staticmethod
    def load(path: Path) -> SegmentAnything:
        """Load a checkpoint: a folder in the format of the module's docstring."""
        if not path.is_dir():
            what = "is a file" if path.exists() else "no such checkpoint of Segment Anything"
            raise InputError(f"{path}: {what}; expected {EXPECTED_WEIGHTS}")
        try:
            import transformers
        except ModuleNotFoundError:
            raise InputError(
                f"{path}: masks by Segment Anything need the package transformers; "
                "pip install 'gva_mi[sam]'"
            ) from None
        transformers.utils.logging.set_verbosity_error()
        transformers.utils.logging.disable_progress_bar()
        about = read_json(path / "config.json", EXPECTED_WEIGHTS)
        kind = about.get("model_type") if isinstance(about, dict) else None
        if not isinstance(kind, str) or kind not in TRANSFORMERS_CLASSES:
            found = f"a network of the kind {kind}"
            raise InputError(f"{path}: holds {found}; expected {EXPECTED_WEIGHTS}")
        try:
            network = getattr(transformers, TRANSFORMERS_CLASSES[kind]).from_pretrained(
                path, local_files_only=True, use_safetensors=True, dtype=torch.float32
            )
        except Exception as error:  # noqa: BLE001 (safetensors and transformers have their own)
            raise InputError(
                f"{path}: cannot be read ({reason_of(error)}); expected {EXPECTED_WEIGHTS}"
            ) from None
        return SegmentAnything(network.eval().requires_grad_(False))

    @torch.inference_mode()
    def find(self, image: np.ndarray, prompt: Prompt, before: MaskGuess | None = None) -> MaskGuess:
        """Segment the person in a picture (H, W, 3) 8-bit, given the frame before's mask."""
        crop = CropBox.round_box(prompt.box, BOX_MARGIN)
        shown = crop.resized(image, self.size, _FILL_COLOR).astype(np.float32)
        seen = torch.from_numpy(shown / 255)
        seen = (seen - torch.tensor(_IMAGENET_MEAN)) / torch.tensor(_IMAGENET_STD)
        embeddings = self.network.get_image_embeddings(seen.permute(2, 0, 1)[None])
        logits, scores = self._guess(embeddings, crop, prompt, None)
        last = None if before is None else before.seen_in(crop)
        if last is not None:
            more = self._guess(embeddings, crop, prompt, last)
            logits, scores = torch.cat([logits, more[0]]), torch.cat([scores, more[1]])
        worth = [
            float(score) + _agreement(guess > 0, crop, prompt) + _overlap(guess, last)
            for guess, score in zip(logits, scores, strict=True)
        ]
        chosen = logits[int(np.argmax(worth))].clone()
        return MaskGuess(_in_picture(chosen, crop, image.shape[:2]), crop, chosen)

    def _guess(
        self, embeddings: object, crop: CropBox, prompt: Prompt, last: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return logits (n, h, w) of the crop, and the overlaps (n,) that the network predicts."""
        # The network itself adds half a pixel to its input.
        place = lambda x: torch.from_numpy(crop.to_network(x, self.size).astype(np.float32) - 0.5)
        found = self.network(
            image_embeddings=embeddings,
            input_boxes=place(prompt.box.reshape(2, 2)).reshape(1, 1, 4),
            input_points=place(prompt.points)[None, None],
            input_labels=torch.from_numpy(prompt.labels.astype(np.int64))[None, None],
            input_masks=None if last is None else last[None, None],
            multimask_output=last is None,
        )
        return found.pred_masks[0, 0], found.iou_scores[0, 0]


def _agreement(inside: torch.Tensor, crop: CropBox, prompt: Prompt) -> float:
    """Score how well a proposal (h, w) agrees with a prompt, in [−1, 2]."""
    side = inside.shape[0]
    place = np.floor(crop.to_network(prompt.points, (side, side))).astype(int).clip(0, side - 1)
    hits, on_person = inside.numpy()[place[:, 1], place[:, 0]], prompt.labels == 1
    share = lambda which: float(hits[which].mean()) if which.any() else 0.0
    left, top, right, bottom = crop.to_network(prompt.box.reshape(2, 2), (side, side)).ravel()
    centres = torch.arange(side) + 0.5
    rows, columns = (centres > top) & (centres < bottom), (centres > left) & (centres < right)
    boxed = inside[rows][:, columns].sum() / inside.sum().clamp(min=1)
    return share(on_person) - share(~on_person) + float(boxed)


def _overlap(guess: torch.Tensor, last: torch.Tensor | None) -> float:
    """Return the IoU of two guesses; 0 without an earlier one."""
    if last is None:
        return 0.0
    both, either = (guess > 0) & (last > 0), (guess > 0) | (last > 0)
    return float(both.sum() / either.sum().clamp(min=1))


def _in_picture(logits: torch.Tensor, crop: CropBox, shape: tuple[int, int]) -> np.ndarray:
    """Convert a crop's logits to the picture's mask (H, W) bool."""
    size = crop.height, crop.width
    whole = interpolate(logits[None, None], size, mode="bilinear", align_corners=False)[0, 0]
    mask = np.zeros(shape, bool)
    left, top = max(0, crop.left), max(0, crop.top)
    right, bottom = min(shape[1], crop.right), min(shape[0], crop.bottom)
    if right > left and bottom > top:
        part = whole[top - crop.top : bottom - crop.top, left - crop.left : right - crop.left]
        mask[top:bottom, left:right] = (part > 0).numpy()
    return mask
