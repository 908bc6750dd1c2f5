"""MediaPipe's landmark networks: fetched once by pip, kept in a cache, run by ai-edge-litert.

The networks are files of the wheel ``mediapipe`` 0.10.21 (Apache-2.0) on the Python Package Index.
pip downloads the wheel (36 MB), so that the user's index, proxy and offline settings hold. It is
unpacked and never installed. Its licence is kept beside the files. Each file must have the SHA-256
of the table below.

The files are in the first of these folders, and missing files are fetched into it:

1. the existing folder that a command's option names;
2. the existing folder that the environment variable ``GVA_MI_WEIGHTS`` names;
3. ``gva_mi/mediapipe-0.10.21`` in the user's cache folder.

On a machine without a network connection, use a folder from another machine.

Networks run on one thread, so every run on a machine gives the same bits.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from gva_mi.core.atomic import require_writable
from gva_mi.core.console import say
from gva_mi.core.errors import InputError, reason_of

MEDIAPIPE_VERSION = "0.10.21"
WEIGHTS_VARIABLE = "GVA_MI_WEIGHTS"  # environment variable
_SHA256 = {  # of each file
    "pose_detection.tflite": "9ba9dd3d42efaaba86b4ff0122b06f29c4122e756b329d89dca1e297fd8f866c",
    "pose_landmark_full.tflite": "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
    "hand_landmark_full.tflite": "11c272b891e1a99ab034208e23937a8008388cf11ed2a9d776ed3d01d0ba00e3",
    "face_landmark.tflite": "1055cb9d4a9ca8b8c688902a3a5194311138ba256bcc94e336d8373a5f30c814",
}
_LICENCE_IN_WHEEL = f"mediapipe-{MEDIAPIPE_VERSION}.dist-info/LICENSE"
_NOTICE = f"""\
The .tflite files of this folder are networks of MediaPipe {MEDIAPIPE_VERSION}, Copyright The
MediaPipe Authors, under the Apache License 2.0: see LICENSE. They are unchanged files of the
package mediapipe on the Python Package Index, which gva_mi has downloaded by pip.
"""
_PIP_DOWNLOAD = (
    "download", "--quiet", "--disable-pip-version-check", "--no-input", "--no-deps",
    "--only-binary", ":all:", "--python-version", "3.11", "--platform", "manylinux_2_28_x86_64",
    f"mediapipe=={MEDIAPIPE_VERSION}",
)  # fmt: skip


def weights_file(name: str) -> Path:
    """Return a file such as ``pose_detection.tflite``, checked; if missing, fetch all files."""
    path = _place() / name
    if not path.is_file():
        require_writable(path.parent)
        _fetch(path.parent)
    _require_hash(path, _SHA256[name])
    return path


def _place() -> Path:
    """Return the folder of the weights: the first in the module's list."""
    if given := os.environ.get(WEIGHTS_VARIABLE):
        given = Path(given).expanduser()
        if not given.is_dir():  # perhaps mistyped: nothing is fetched into it
            raise InputError(f"{given}: no such folder; expected the folder of the networks")
        return given
    cache = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    return cache / "gva_mi" / f"mediapipe-{MEDIAPIPE_VERSION}"


def _fetch(folder: Path) -> None:
    """Download the wheel, and move its networks and its licence into the folder."""
    say(f"fetching MediaPipe's landmark networks by pip (36 MB, once) into {folder}")
    with tempfile.TemporaryDirectory(dir=folder, prefix=".fetching-") as scratch:
        wheel = _download(Path(scratch), folder)
        try:
            with zipfile.ZipFile(wheel) as archive:
                files = {name: _in_wheel(name) for name in _SHA256} | {"LICENSE": _LICENCE_IN_WHEEL}
                for name, inside in files.items():
                    (Path(scratch) / name).write_bytes(archive.read(inside))
        except (zipfile.BadZipFile, KeyError) as error:
            raise InputError(
                f"{wheel.name}: is not the wheel of mediapipe {MEDIAPIPE_VERSION} "
                f"({reason_of(error)}); check the package index that pip uses"
            ) from None
        (Path(scratch) / "NOTICE").write_text(_NOTICE)
        for name, expected in _SHA256.items():
            _require_hash(Path(scratch) / name, expected)
        for name in ("NOTICE", *files):
            (Path(scratch) / name).replace(folder / name)


def _in_wheel(name: str) -> str:
    """Return where a file lies in the wheel: in a folder of its network's name."""
    return f"mediapipe/modules/{name.removesuffix('.tflite').removesuffix('_full')}/{name}"


def _download(scratch: Path, folder: Path) -> Path:
    """Download the wheel into ``scratch`` by this Python's own pip."""
    command = [sys.executable, "-m", "pip", *_PIP_DOWNLOAD, "--dest", str(scratch)]
    run = subprocess.run(command, capture_output=True, text=True)
    wheels = sorted(scratch.glob("*.whl"))
    if run.returncode == 0 and wheels:
        return wheels[0]
    lines = [f"pip ended with {run.returncode}", *run.stderr.splitlines()]
    reason = [line.strip() for line in lines if line.strip()][-1].removeprefix("ERROR: ")
    raise InputError(
        f"{folder}: the landmark networks are missing, and pip cannot fetch them ({reason:.200}); "
        f"go online once, or set {WEIGHTS_VARIABLE} to a folder with {', '.join(_SHA256)} "
        f"of the wheel mediapipe {MEDIAPIPE_VERSION}"
    )


def _require_hash(path: Path, expected: str) -> None:
    """Raise an InputError if a file has another SHA-256 than expected."""
    found = hashlib.sha256(path.read_bytes()).hexdigest()
    if found != expected:
        raise InputError(
            f"{path}: is not MediaPipe's file (SHA-256 {found[:12]}..., expected "
            f"{expected[:12]}...); delete it, so that it can be fetched again"
        )


class TfliteNetwork:
    """A network that takes a square picture (1, S, S, 3) float32."""

    def __init__(self, path: Path) -> None:
        """Open the file."""
        try:
            from ai_edge_litert.interpreter import Interpreter
        except ImportError as error:
            raise InputError(
                f"{path.name}: needs the package ai-edge-litert to be run ({error}); "
                "pip install 'gva_mi[video]'"
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
    """Discard what a library writes to standard error, such as a list of its kernels."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
