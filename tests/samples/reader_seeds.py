"""Good files of estimators, data sets and networks, to test their readers with.

Folders of several cameras hold out views, so that the files of all of their cameras are read.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from gva_mi.networks.normals import NormalNetwork, NormalsSpec
from gva_mi.readers.estimators import VideoInfo, read_estimator
from gva_mi.readers.prepare import PrepareOptions, prepare_folder
from gva_mi.readers.target_body import TargetBody
from samples import data_sets as filmed
from samples.estimates import WRITTEN
from samples.networks import onnx_file


def readers():
    """Return how to write the good files of each reader, and the reader, by name."""
    built_in = TargetBody.read(None)
    rotations = np.full((filmed.FRAMES, 55, 3), 0.1)
    rotations[:, 0] = [np.pi, 0, 0]
    places = np.tile([0.0, 0, 4], (filmed.FRAMES, 1))
    thetas = rotations[:, :24].reshape(-1, 72)

    def estimated(name):
        where = []

        def write(folder):
            source, *_ = WRITTEN[name](folder, rotations, places)
            where[:] = [source.relative_to(folder)]

        info = VideoInfo((filmed.WIDTH, filmed.HEIGHT), 40.0)
        return write, lambda folder, _=None: read_estimator("auto", folder / where[0], info)

    def prepared(kind, write):
        def read(folder, _=None):
            options = PrepareOptions(body=Path("built-in"), views=("all",))
            with TemporaryDirectory() as out:
                prepare_folder(Path(out), kind, folder, options, built_in)

        return write, read

    def read_onnx(folder, _=None):
        mask = np.zeros((24, 32), np.float32)
        mask[4:20, 8:24] = 1
        network = NormalNetwork(folder / "a.onnx", NormalsSpec("icon", (16, 16)))
        network.see(np.full((24, 32, 3), 99, np.uint8), mask, np.array([8.0, 4, 24, 20]))

    return {
        **{name: estimated(name) for name in ("wham", "gvhmr", "smplerx")},
        "romp": estimated("romp frames"),
        "zju": prepared("zju", lambda f: filmed.zju(f, thetas, places, cameras=(1, 2), D=0.01)),
        "onnx": (lambda folder: onnx_file(folder / "a.onnx", (16, 16)), read_onnx),
    }  # fmt: skip
