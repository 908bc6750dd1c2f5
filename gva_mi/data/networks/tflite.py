"""Run a network in a ``.tflite`` file by the package ai-edge-litert, on one thread.

One thread gives the same bits in every run on a machine, whatever else the machine does.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from gva_mi.core.errors import InputError, reason_of


class TfliteNetwork:
    """A network that takes a square picture (1, S, S, 3) float32."""

    def __init__(self, path: Path) -> None:
        """Open the file."""
        try:
            from ai_edge_litert.interpreter import Interpreter
        except ImportError as error:
            raise InputError(
                f"{path.name}: needs the package ai-edge-litert to be run ({error}); "
                "pip install 'gva_mi[film]'"
            ) from None
        try:
            with _silent_stderr():
                self._network = Interpreter(str(path), num_threads=1)
                self._network.allocate_tensors()
        except (ValueError, RuntimeError) as error:
            raise InputError(f"{path}: is no readable .tflite ({reason_of(error)})") from None
        (given,) = self._network.get_input_details()
        self._input = given["index"]
        self._outputs = {out["name"]: out["index"] for out in self._network.get_output_details()}
        self.size = int(given["shape"][1])  # S pixels

    def __call__(self, picture: np.ndarray) -> dict[str, np.ndarray]:
        """Return the outputs by name, without their first axis, for a picture (S, S, 3)."""
        self._network.set_tensor(self._input, np.ascontiguousarray(picture[None], np.float32))
        self._network.invoke()
        return {name: self._network.get_tensor(k)[0] for name, k in self._outputs.items()}


def sigmoid(logits: np.ndarray) -> np.ndarray:
    """Return probabilities in [0, 1] of logits."""
    return 1 / (1 + np.exp(-np.clip(logits, -50.0, 50.0)))


@contextmanager
def _silent_stderr() -> Iterator[None]:
    """Drop what a library writes to the process's standard error, such as which kernels it has."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
