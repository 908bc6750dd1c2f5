"""``TargetBody``: the body that poses are converted to, and what it keeps of a source's poses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from gva_mi.body.body_file import read_body
from gva_mi.body.built_in import BUILT_IN_BODY
from gva_mi.body.pose import Shape
from gva_mi.body.smplx import BodyModel, body_file, body_name


@dataclass(frozen=True)
class TargetBody:
    """The body that poses are for."""

    name: str
    model: BodyModel
    joints: np.ndarray  # (55, 3) at rest, of the mean shape, metres
    mean_hands: np.ndarray  # (30, 3) left before right, relative to flat ones
    own_betas: bool  # it is SMPL-X, whose betas an estimator of SMPL-X gives
    components: np.ndarray | None  # (2, K, 45) of SMPL-X's PCA of hands, in the same order

    @staticmethod
    def read(path: Path | None) -> TargetBody:
        """Read a body's file; the built-in body for the word ``puppet``, or for None."""
        path = path or BUILT_IN_BODY
        arrays = read_body(body_file(path))
        hands = [arrays.get(f"hands_mean{side}", np.zeros(45)) for side in "lr"]
        # SMPL-X alone has a face; the built-in body has one, and betas of its own.
        own_betas = body_file(path) != BUILT_IN_BODY and int(arrays["num_expressions"]) > 0
        components = None
        if own_betas and "hands_componentsl" in arrays:
            components = np.stack([arrays[f"hands_components{side}"] for side in "lr"])
        model = BodyModel(arrays)
        joints = model.rest(Shape(torch.zeros(0))).joints.double().numpy()
        hands = np.stack(hands).reshape(30, 3)
        return TargetBody(body_name(path), model, joints, hands, own_betas, components)

    def keeps_betas(self, form: str) -> bool:
        """Whether this body can use the betas of a source with this body model."""
        return self.own_betas and form == "SMPL-X"

    def takes_over(self, form: str) -> str:
        """Return a note on what this body keeps of a source with this body model."""
        if self.keeps_betas(form):
            return f"for the body {self.name}: rotations, place and betas are the source's own"
        return (
            f"retargeted to the body {self.name}: rotations and the pelvis's place are the "
            "source's; lengths of limbs and shape are this body's"
        )
