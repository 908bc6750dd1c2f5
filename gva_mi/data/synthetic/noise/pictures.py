"""What goes wrong in the pictures of one frame: its mask and its normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gva_mi.data.normals import to_icon
from gva_mi.data.synthetic.noise.families import Levels, Noise
from gva_mi.data.synthetic.noise.masks import Mistaken, noisy_mask
from gva_mi.data.synthetic.noise.normals import noisy_normals
from gva_mi.splat import Camera


@dataclass(frozen=True)
class PictureNoise:
    """The noise of one frame's mask and normals."""

    noise: Noise
    levels: Levels
    camera: Camera
    seed: tuple[int, ...]  # of all that is random in it
    mistaken: Mistaken = Mistaken()
    no_normals: bool = False  # whether the frame has none

    def of(self, mask: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """A noisy mask (H, W), and noisy normals (H, W, 3) in camera space, from the true ones."""
        _, errors = np.random.SeedSequence(self.seed).spawn(2)  # the first is the renderer's
        of_mask, of_normals = (np.random.default_rng(s) for s in errors.spawn(2))
        mask = noisy_mask(mask, self.noise.mask, self.levels.mask, of_mask, self.mistaken)
        if self.no_normals:
            return mask, None
        normals = noisy_normals(normals, mask, self.noise.normal, self.levels.normal, of_normals)
        return mask, normals

    def in_convention(self, normals: np.ndarray) -> np.ndarray:
        """Normals in camera space as the network writes them."""
        if self.noise.normal.convention == "icon" and self.levels.normal > 0:
            return to_icon(normals, self.camera)
        return normals
