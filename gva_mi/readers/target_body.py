"""``TargetBody``: the body that poses of other programs are converted to.

Rotations are the same on all bodies of the SMPL family. Betas and expressions belong to one body
model, and so does the pelvis at rest, about which a body turns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from gva_mi.body.body_file import BUILT_IN_BODY, SMPL, SMPLH, SMPLX, read_body
from gva_mi.body.pose import Shape
from gva_mi.body.smplx import BodyModel, body_name, resolve_body
from gva_mi.subject.fingerprint import belongs_to

# Metres: the pelvis of the mean neutral person at rest, as the public models regress it.
MEAN_PELVIS = {
    "SMPL": (-0.0018, -0.2233, 0.0282), "SMPL+H": (-0.0018, -0.2233, 0.0282),
    "SMPL-X": (0.0031, -0.3514, 0.0120),
}  # fmt: skip
_PELVIS_TOLERANCE = 0.05  # metres: the male and the female mean person are nearer than this
OWN_FORM = "own"  # form of a body in SMPL-X's file format that is none of the public models


@dataclass(frozen=True)
class TargetBody:
    """The body that poses are converted to."""

    name: str
    model: BodyModel
    form: str  # "SMPL", "SMPL+H", "SMPL-X" or OWN_FORM
    joints: np.ndarray  # (55, 3) at rest, of the mean shape, metres
    mean_hands: np.ndarray  # (30, 3) left before right, relative to flat ones
    of_source: bool = False  # the source's poses were made on this very body

    @staticmethod
    def read(path: Path | None) -> TargetBody:
        """Read a body's file; the built-in body for the word ``built-in``, or for None."""
        path = path or BUILT_IN_BODY
        arrays = read_body(resolve_body(path))
        hands = [arrays.get(f"hands_mean{side}", np.zeros(45)) for side in "lr"]
        model = BodyModel(arrays)
        joints = model.rest(Shape(torch.zeros(0))).joints.double().numpy()
        # Recognise the model by the joints that move it and by its pelvis, because other bodies,
        # with betas of their own, come in SMPL-X's file format, too.
        moved = set(np.flatnonzero(arrays["weights"].any(0)).tolist())
        form = next((f for f in (SMPL, SMPLH) if moved <= set(f.joints)), SMPLX).name
        form = (
            form if np.linalg.norm(joints[0] - MEAN_PELVIS[form]) < _PELVIS_TOLERANCE else OWN_FORM
        )
        hands = np.stack(hands).reshape(30, 3)
        return TargetBody(body_name(path), model, form, joints, hands)

    def for_source(self, source: Path) -> TargetBody:
        """Return this body, marked as the source's if the source lies in a subject made on it."""
        folder = source if source.is_dir() else source.parent
        return replace(self, of_source=belongs_to(folder, self.model))

    def keeps_betas(self, form: str) -> bool:
        """Whether betas and expressions of a body of a ``form`` hold for this body."""
        return self.of_source or form == self.form

    def pelvises(self, form: str, betas: np.ndarray | None) -> np.ndarray:
        """Return the pelvis at rest, (3,) or (n, 3) metres, of a source's body with ``betas``.

        ``betas`` are (B,) or (n, B). If the source's body is not this one, its mean person's pelvis
        is returned; betas move it by centimetres.
        """
        if not self.keeps_betas(form):
            return np.array(MEAN_PELVIS[form])
        betas = np.zeros(0) if betas is None else betas
        moves = self.model.shape_joints[:, :3].double().numpy()
        count = min(len(moves), betas.shape[-1])
        return self.joints[0] + betas[..., :count] @ moves[:count]

    def expression(self, form: str, given: np.ndarray) -> tuple[np.ndarray, list[str]]:
        """Keep the expression coefficients (T, E) that this body shares, ten at most; and notes."""
        if not self.keeps_betas(form):
            if not given.any():
                return np.zeros((len(given), 10)), []
            note = f"the face's expression is left out: coefficients of {form} are not the body's"
            return np.zeros((len(given), 10)), [f"{note} {self.name}"]
        count = min(10, self.model.num_expressions, given.shape[1])
        note = [f"the first {count} of {given.shape[1]} coefficients of the expression are kept"]
        return given[:, :count], note if given[:, count:].any() else []
