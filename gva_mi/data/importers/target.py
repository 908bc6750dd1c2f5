"""``TargetBody``: the body that poses are converted to, and what it keeps of a source's poses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from gva_mi.body.body_file import BUILT_IN_BODY, SMPL, SMPLH, SMPLX, read_body
from gva_mi.body.pose import Shape
from gva_mi.body.smplx import BodyModel, body_name, resolve_body
from gva_mi.data.fingerprint import belongs_to

# The pelvis of the neutral mean person at rest, metres, as the public models regress it.
PELVIS = {
    "SMPL": (-0.0018, -0.2233, 0.0282), "SMPL+H": (-0.0018, -0.2233, 0.0282),
    "SMPL-X": (0.0031, -0.3514, 0.0120),
}  # fmt: skip
_NEAR = 0.05  # metres of it are those of the male and of the female mean


@dataclass(frozen=True)
class TargetBody:
    """The body that poses are for."""

    name: str
    model: BodyModel
    form: str  # "SMPL", "SMPL+H" or "SMPL-X"; "own" for another body in such a file
    joints: np.ndarray  # (55, 3) at rest, of the mean shape, metres
    mean_hands: np.ndarray  # (30, 3) left before right, relative to flat ones
    components: np.ndarray | None  # (2, K, 45) of SMPL-X's PCA of hands, in the same order
    of_source: bool = False  # the source's poses were made on this very body

    @staticmethod
    def read(path: Path | None) -> TargetBody:
        """Read a body's file; the built-in body for the word ``puppet``, or for None."""
        path = path or BUILT_IN_BODY
        arrays = read_body(resolve_body(path))
        hands = [arrays.get(f"hands_mean{side}", np.zeros(45)) for side in "lr"]
        components = None
        if resolve_body(path) != BUILT_IN_BODY and "hands_componentsl" in arrays:
            components = np.stack([arrays[f"hands_components{side}"] for side in "lr"])
        model = BodyModel(arrays)
        joints = model.rest(Shape(torch.zeros(0))).joints.double().numpy()
        # The model is known by the joints that move it and by its pelvis: other bodies come in
        # SMPL-X's format, too, and have betas of their own.
        moved = set(np.flatnonzero(arrays["weights"].any(0)).tolist())
        form = next((f for f in (SMPL, SMPLH) if moved <= set(f.joints)), SMPLX).name
        form = form if np.linalg.norm(joints[0] - PELVIS[form]) < _NEAR else "own"
        hands = np.stack(hands).reshape(30, 3)
        return TargetBody(body_name(path), model, form, joints, hands, components)

    def for_source(self, source: Path) -> TargetBody:
        """Return this body, marked if the subject's folder that poses lie in was made on it."""
        folder = source if source.is_dir() else source.parent
        return replace(self, of_source=belongs_to(folder, self.model))

    def keeps_betas(self, form: str) -> bool:
        """Whether betas and expressions of a source with this body model are this body's."""
        return self.of_source or form == self.form

    def pelvises(self, form: str, betas: np.ndarray | None) -> np.ndarray:
        """Return the pelvis at rest, (3,) or (n, 3) metres, of a source's body with ``betas``.

        They are (B,) or (n, B). Without that body at hand it is the mean person's, which betas
        move by centimetres.
        """
        if not self.keeps_betas(form):
            return np.array(PELVIS[form])
        betas = np.zeros(0) if betas is None else betas
        moves = self.model.shape_joints[:, :3].double().numpy()
        count = min(len(moves), betas.shape[-1])
        return self.joints[0] + betas[..., :count] @ moves[:count]

    def expression(self, form: str, given: np.ndarray) -> tuple[np.ndarray, list[str]]:
        """Return what of a source's expressions (T, E) is this body's, ten at most, and notes."""
        if not self.keeps_betas(form):
            if not given.any():
                return np.zeros((len(given), 10)), []
            note = f"the face's expression is left out: coefficients of {form} are not the body's"
            return np.zeros((len(given), 10)), [f"{note} {self.name}"]
        count = min(10, self.model.num_expressions, given.shape[1])
        note = [f"the first {count} of {given.shape[1]} coefficients of the expression are kept"]
        return given[:, :count], note if given[:, count:].any() else []
