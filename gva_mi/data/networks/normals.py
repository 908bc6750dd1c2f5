"""Estimate the person's normals by a network in a TorchScript or an ONNX file.

Input: (1, 3, h, w) float32, the person cut out, (rgb/255 − mean) / std. Output: normals
(1, 3, h', w') of unit length, or (n + 1) / 2; the first array where there are several.

With the convention ``icon`` the background becomes the mean first, as ICON, ECON and PIFuHD are
trained. With the other conventions it stays.

A TorchScript file is a program and runs here with the user's rights: trust it as you would any
program. ONNX describes arithmetic alone.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from gva_mi.core.errors import InputError
from gva_mi.data.networks.crop import CropBox
from gva_mi.data.normals import LONGEST, SHORTEST, Convention

SUFFIXES = (".pt", ".pth", ".torchscript", ".onnx")
MARGIN = 0.1  # of the longer side of the mask's box, around it: shown to the network
_ASKED = "a network that takes (1, 3, h, w) and answers with normals (1, 3, h, w)"

Answer = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class NormalsSpec:
    """What a network of normals takes, and what its output means."""

    convention: Convention  # axes, and the kind of view: gva_mi.data.normals
    size: tuple[int, int] = (512, 512)  # (w, h) pixels, where an ONNX file does not say it itself
    mean: tuple[float, float, float] = (0.5, 0.5, 0.5)  # of red, green, blue in [0, 1]
    std: tuple[float, float, float] = (0.5, 0.5, 0.5)  # likewise; so that all lies in [−1, 1]


class NormalNetwork:
    """A network in a file, and what it takes."""

    def __init__(self, path: Path, spec: NormalsSpec) -> None:
        """Read the file.

        Raises:
            InputError: nothing is there, a package is missing, or it is of another form.
        """
        if path.suffix.lower() not in SUFFIXES or not path.is_file():
            raise InputError(
                f"{path}: no such network of normals; expected a file {', '.join(SUFFIXES)} of "
                f"{_ASKED}"
            )
        self.path = path
        onnx = path.suffix.lower() == ".onnx"
        self._answer, size = _onnx(path) if onnx else (_torch_script(path), None)
        self.spec = replace(spec, size=size or spec.size)

    def see(
        self, image: np.ndarray, mask: np.ndarray, box: np.ndarray
    ) -> tuple[CropBox, np.ndarray]:
        """Estimate normals of a picture (H, W, 3) 8-bit, of a mask (H, W) with a box (4,).

        Returns:
            The part of the picture that is shown, and (h, w, 3) unit normals in the convention's
            axes, zero where unknown.

        Raises:
            InputError: the network fails, or its output is of another form.
        """
        crop = CropBox.round_box(box, MARGIN, self.spec.size)
        mean, std = np.array(self.spec.mean), np.array(self.spec.std)
        fill = np.round(255 * mean)
        if self.spec.convention == "icon":
            image = np.round(image * mask[..., None] + fill * (1 - mask[..., None]))
        shown = crop.cut(image.astype(np.uint8), self.spec.size, tuple(fill.astype(int).tolist()))
        given = ((shown / 255 - mean) / std).astype(np.float32).transpose(2, 0, 1)[None]
        return crop, self._checked(self._answer(given))

    def _checked(self, answer: np.ndarray) -> np.ndarray:
        """Unit normals (h, w, 3) of the network's output."""
        if answer.ndim != 4 or answer.shape[:2] != (1, 3) or answer.dtype.kind != "f":
            raise InputError(
                f"{self.path}: answers with {answer.dtype} {answer.shape}; expected {_ASKED}"
            )
        normals = answer[0].transpose(1, 2, 0).astype(np.float32)
        normals = np.where(np.isfinite(normals).all(-1, keepdims=True), normals, 0)
        if normals.min() >= 0 and _from_unit(2 * normals - 1) < _from_unit(normals):
            normals = 2 * normals - 1
        length = np.linalg.norm(normals, axis=-1, keepdims=True)
        known = (length > SHORTEST) & (length < LONGEST)
        if not known.any():
            raise InputError(
                f"{self.path}: answers with vectors {length.min():.3g} to {length.max():.3g} long, "
                "which are no normals; expected lengths near 1"
            )
        return np.where(known, normals / np.maximum(length, 1e-6), 0)


def _from_unit(normals: np.ndarray) -> float:
    """Median distance of the vectors (h, w, 3) from unit length."""
    return float(np.median(np.abs(np.linalg.norm(normals, axis=-1) - 1)))


def _torch_script(path: Path) -> Answer:
    try:
        with warnings.catch_warnings():  # torch recommends torch.export, which few files use
            warnings.simplefilter("ignore", DeprecationWarning)
            network = torch.jit.load(path, map_location="cpu").eval()
    except (RuntimeError, ValueError, OSError) as error:
        raise InputError(
            f"{path}: no TorchScript ({_first_line(error)}); expected what torch.jit.save wrote of "
            f"{_ASKED}"
        ) from None

    @torch.inference_mode()
    def answer(given: np.ndarray) -> np.ndarray:
        try:
            found = _first(network(torch.from_numpy(given)))
        except (RuntimeError, torch.jit.Error) as error:
            raise InputError(f"{path}: fails ({_first_line(error)}); expected {_ASKED}") from None
        return found.float().numpy() if isinstance(found, torch.Tensor) else np.asarray(found)

    return answer


def _onnx(path: Path) -> tuple[Answer, tuple[int, int] | None]:
    """A function that runs the network, and the (w, h) that the file fixes."""
    try:
        import onnxruntime
    except ModuleNotFoundError:
        raise InputError(
            f"{path}: needs the package onnxruntime to be run; pip install 'gva_mi[onnx]'"
        ) from None
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4  # its messages come as an InputError
    try:
        session = onnxruntime.InferenceSession(
            str(path), options, providers=["CPUExecutionProvider"]
        )
    except Exception as error:  # noqa: BLE001 (each of its errors is a class of its own)
        raise InputError(
            f"{path}: no ONNX network ({_first_line(error)}); expected {_ASKED}"
        ) from None
    inputs = session.get_inputs()
    if len(inputs) != 1 or len(inputs[0].shape) != 4 or inputs[0].type != "tensor(float)":
        found = ", ".join(f"{x.name} {x.type} {x.shape}" for x in inputs)
        raise InputError(f"{path}: takes {found}; expected {_ASKED}")
    sides = inputs[0].shape[2:]
    size = tuple(sides[::-1]) if all(isinstance(side, int) for side in sides) else None

    def answer(given: np.ndarray) -> np.ndarray:
        try:
            return np.asarray(session.run(None, {inputs[0].name: given})[0])
        except Exception as error:  # noqa: BLE001 (as above)
            raise InputError(f"{path}: fails ({_first_line(error)}); expected {_ASKED}") from None

    return answer, size


def _first(found: object) -> object:
    """The first array of an answer."""
    while isinstance(found, (tuple, list, dict)) and len(found):
        found = next(iter(found.values())) if isinstance(found, dict) else found[0]
    return found


def _first_line(error: Exception) -> str:
    """One line of an error; in TorchScript's traces, the last one with the reason."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    chosen = next((line for line in reversed(lines) if "Error:" in line), lines[0] if lines else "")
    return f"{chosen or type(error).__name__:.120}"
