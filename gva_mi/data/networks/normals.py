"""The person's normals, by a network in a TorchScript or an ONNX file.

===========================  ============================================================
What the network is given    (1, 3, h, w) float32: the person cut out, (rgb/255 − mean) / std
What it has to answer        normals (1, 3, h', w') of unit length, or (n + 1) / 2 of these;
                             the first array where it answers with several
===========================  ============================================================

Where the convention is ``icon``, what is around the person is taken away first, as ICON, ECON and
PIFuHD are trained: it becomes the mean. In the other conventions the surroundings stay.

A TorchScript file is a program and runs here as whoever starts it: trust it as you would any
program. ONNX describes arithmetic alone.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from gva_mi.data.networks.crop import Crop
from gva_mi.data.normals import LONGEST, SHORTEST, Convention
from gva_mi.errors import InputError

SUFFIXES = (".pt", ".pth", ".torchscript", ".onnx")
MARGIN = 0.1  # of the longer side of the mask's box, round it: what the network sees
_ASKED = "a network that takes (1, 3, h, w) and answers with normals (1, 3, h, w)"

Answer = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Expected:
    """What a network of normals is given, and what it means by its answer."""

    convention: Convention  # axes, and the kind of view: gva_mi.data.normals
    size: tuple[int, int] = (512, 512)  # (w, h) pixels, where an ONNX file does not say it itself
    mean: tuple[float, float, float] = (0.5, 0.5, 0.5)  # of red, green, blue in [0, 1]
    std: tuple[float, float, float] = (0.5, 0.5, 0.5)  # likewise; so that all lies in [−1, 1]


class NormalNetwork:
    """A network of a file, and what it expects."""

    def __init__(self, path: Path, how: Expected) -> None:
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
        self.how = Expected(how.convention, size or how.size, how.mean, how.std)

    def see(self, image: np.ndarray, mask: np.ndarray, box: np.ndarray) -> tuple[Crop, np.ndarray]:
        """The normals of a person.

        Args:
            image: (H, W, 3) 8-bit.
            mask: (H, W) in [0, 1].
            box: (4,) of the mask.

        Returns:
            The part of the picture that is shown, and (h, w, 3) unit normals in the convention's
            axes, zero where unknown.

        Raises:
            InputError: the network fails, or answers with something else.
        """
        crop = Crop.round_box(box, MARGIN, self.how.size)
        mean, std = np.array(self.how.mean), np.array(self.how.std)
        fill = np.round(255 * mean)
        if self.how.convention == "icon":
            image = np.round(image * mask[..., None] + fill * (1 - mask[..., None]))
        shown = crop.cut(image.astype(np.uint8), self.how.size, tuple(fill.astype(int).tolist()))
        given = ((shown / 255 - mean) / std).astype(np.float32).transpose(2, 0, 1)[None]
        return crop, self._checked(self._answer(given))

    def _checked(self, answer: np.ndarray) -> np.ndarray:
        """Unit normals (h, w, 3) of an answer."""
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
    """How far vectors (h, w, 3) are from unit length, in the median."""
    return float(np.median(np.abs(np.linalg.norm(normals, axis=-1) - 1)))


def _torch_script(path: Path) -> Answer:
    try:
        with warnings.catch_warnings():  # torch would rather have torch.export, which few files are
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
    """What runs the network, and the (w, h) that the file itself says."""
    try:
        import onnxruntime
    except ModuleNotFoundError:
        raise InputError(
            f"{path}: needs the package onnxruntime to be run; pip install 'gva_mi[onnx]'"
        ) from None
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4  # its own words come as an InputError
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
    """What an error says, shortly: of TorchScript's traces the last line is the reason."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    chosen = next((line for line in reversed(lines) if "Error:" in line), lines[0] if lines else "")
    return f"{chosen or type(error).__name__:.120}"
