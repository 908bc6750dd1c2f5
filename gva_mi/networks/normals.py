"""Estimate the person's normals by a network in an ONNX file.

=====================  ==========================================================================
input                  value
=====================  ==========================================================================
(1, 3, h, w)           a crop around the person, (rgb/255 − mean) / std; any name
an integer, optional   the number of patches of 14 by 14 pixels, ``num_tokens`` of MoGe-2; then
                       mean and std are 0 and 1 by default
=====================  ==========================================================================

Output: normals (1, 3, h', w') or (1, h', w', 3) of unit length, or (n + 1) / 2. Of several outputs,
the one named ``normal`` is taken, as of MoGe-2.

With the convention ``icon`` the background is replaced by the mean, as in PIFuHD's training. With
the other conventions it stays.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gva_mi.core.errors import InputError, reason_of
from gva_mi.subject.crop import CropBox
from gva_mi.subject.normals import LONGEST_NORMAL, SHORTEST_NORMAL, Convention

BOX_MARGIN = 0.1  # of the mask's box's longer side, on each side. Chosen: it shows the outline
NORMAL_OUTPUT = "normal"  # name of the output that is used, of several
PATCH_PIXELS = 14  # side of a patch of DINOv2, the encoder of MoGe-2
if TYPE_CHECKING:
    from onnxruntime import InferenceSession

_EXPECTED_NETWORK = (
    "a network that takes a picture (1, 3, h, w) and answers with normals (1, 3, h, w) or "
    "(1, h, w, 3)"
)


@dataclass(frozen=True)
class NormalsSpec:
    """Input and output conventions of a normal network."""

    convention: Convention  # axes, and the kind of view: gva_mi.subject.normals
    size: tuple[int, int] = (512, 512)  # (w, h) pixels, where an ONNX file does not say it itself
    # Of red, green, blue in [0, 1]; None: 0.5 and 0.5, which gives inputs in [−1, 1]; or 0 and 1
    # for a network with a number of patches.
    mean: tuple[float, float, float] | None = None
    std: tuple[float, float, float] | None = None
    output: str | None = None  # its name; None: the only one, or NORMAL_OUTPUT


class NormalNetwork:
    """A normal network in an ONNX file, with its conventions."""

    def __init__(self, path: Path, spec: NormalsSpec) -> None:
        """Open the file; ``spec`` are its conventions."""
        if path.suffix.lower() != ".onnx" or not path.is_file():
            raise InputError(
                f"{path}: no such network of normals; expected a file .onnx of {_EXPECTED_NETWORK}"
            )
        self.path, self._session = path, _session(path)
        inputs = self._session.get_inputs()
        pictures = [x for x in inputs if len(x.shape) == 4 and x.type == "tensor(float)"]
        numbers = [x for x in inputs if x.type == "tensor(int64)" and x.shape in ([], [1])]
        if len(pictures) != 1 or 1 + len(numbers) != len(inputs) or len(numbers) > 1:
            found = ", ".join(f"{x.name} {x.type} {x.shape}" for x in inputs)
            raise InputError(f"{path}: takes {found}; expected {_EXPECTED_NETWORK}")
        names, self._picture = [x.name for x in self._session.get_outputs()], pictures[0]
        self._output = spec.output or (names[0] if len(names) == 1 else NORMAL_OUTPUT)
        if self._output not in names:
            raise InputError(
                f"{path}: has the outputs {', '.join(names)}; expected one output, or one with the "
                f"name {self._output}"
            )
        mean, std = (0.0, 1.0) if numbers else (0.5, 0.5)
        spec = replace(spec, mean=spec.mean or (mean,) * 3, std=spec.std or (std,) * 3)
        fixed = self._picture.shape[:1:-1]  # (w, h), where the file says them
        sides = all(isinstance(side, int) for side in fixed)
        self.spec = replace(spec, size=tuple(fixed) if sides else spec.size)

    def see(
        self, image: np.ndarray, mask: np.ndarray, box: np.ndarray
    ) -> tuple[CropBox, np.ndarray]:
        """Estimate normals of a picture (H, W, 3) 8-bit, of a mask (H, W) with a box (4,).

        Returns:
            the part that is shown, and (h, w, 3) unit normals in the convention's axes, zero where
            unknown.
        """
        crop = CropBox.round_box(box, BOX_MARGIN, self.spec.size)
        mean, std = np.array(self.spec.mean), np.array(self.spec.std)
        fill = np.round(255 * mean)
        if self.spec.convention == "icon":
            image = np.round(image * mask[..., None] + fill * (1 - mask[..., None]))
        color = tuple(fill.astype(int).tolist())
        shown = crop.resized(image.astype(np.uint8), self.spec.size, color)
        planes = ((shown / 255 - mean) / std).astype(np.float32).transpose(2, 0, 1)[None]
        inputs = {self._picture.name: planes}
        width, height = self.spec.size
        for x in self._session.get_inputs():
            if x.name != self._picture.name:
                patches = np.array(round(width * height / PATCH_PIXELS**2))
                inputs[x.name] = patches.reshape([1] * len(x.shape))
        try:
            answer = np.asarray(self._session.run([self._output], inputs)[0])
        except Exception as error:  # noqa: BLE001 (each of its errors is a class of its own)
            reason = f"fails ({reason_of(error)})"
            raise InputError(f"{self.path}: {reason}; expected {_EXPECTED_NETWORK}") from None
        return crop, self._unit_normals(answer)

    def _unit_normals(self, answer: np.ndarray) -> np.ndarray:
        """Convert the network's output to unit normals (h, w, 3)."""
        planes = answer.ndim == 4 and answer.shape[:2] == (1, 3)
        rows = answer.ndim == 4 and (answer.shape[0], answer.shape[3]) == (1, 3)
        if not (planes or rows) or answer.dtype.kind != "f":
            found = f"{answer.dtype} {answer.shape}"
            raise InputError(f"{self.path}: answers with {found}; expected {_EXPECTED_NETWORK}")
        normals = (answer[0].transpose(1, 2, 0) if planes else answer[0]).astype(np.float32)
        normals = np.where(np.isfinite(normals).all(-1, keepdims=True), normals, 0)
        if normals.min() >= 0 and _from_unit(2 * normals - 1) < _from_unit(normals):
            normals = 2 * normals - 1
        length = np.linalg.norm(normals, axis=-1, keepdims=True)
        known = (length > SHORTEST_NORMAL) & (length < LONGEST_NORMAL)
        if not known.any():
            raise InputError(
                f"{self.path}: answers with vectors {length.min():.3g} to {length.max():.3g} long, "
                "which are no normals; expected lengths near 1"
            )
        return np.where(known, normals / np.maximum(length, 1e-6), 0)


def _from_unit(normals: np.ndarray) -> float:
    """Return the median deviation of the vectors (h, w, 3) from unit length."""
    return float(np.median(np.abs(np.linalg.norm(normals, axis=-1) - 1)))


def _session(path: Path) -> InferenceSession:
    """Open an ONNX file with onnxruntime."""
    try:
        import onnxruntime
    except ModuleNotFoundError:
        raise InputError(
            f"{path}: needs the package onnxruntime to be run; pip install 'gva_mi[onnx]'"
        ) from None
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4  # its messages come as an InputError
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # noqa: BLE001 (as above)
        reason = f"no ONNX network ({reason_of(error)})"
        raise InputError(f"{path}: {reason}; expected {_EXPECTED_NETWORK}") from None
