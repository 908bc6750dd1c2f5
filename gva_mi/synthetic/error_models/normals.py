"""Error model of normals: level 1 is usual, 0 is exact.

Normals are blurred and turned by an error that varies slowly over the picture. They may also be
flattened, turned the same way in every frame, given in another convention, or missing in frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gva_mi.body.rotations import to_matrices
from gva_mi.data.normals import Convention
from gva_mi.synthetic.error_models.processes import field


@dataclass(frozen=True)
class NormalErrors:
    """Sizes of the errors of a video's normals."""

    blur: float = 2.2  # px at 512, standard deviation
    tilt: float = 0.14  # rad, error that varies over the picture
    tilt_length: float = 50.0  # px at 512, scale of its variation
    flat: float = 0.0  # relative shortening across the line of sight, before normalisation
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)  # rad, constant, camera axes
    convention: Convention = "perspective"  # of the files
    missing: float = 0.0  # fraction of the frames without normals

    def convention_at(self, level: float) -> Convention:
        """Return the convention of the files; exact ones are as rendered."""
        return self.convention if level > 0 else "perspective"


def noisy_normals(
    normals: np.ndarray,
    mask: np.ndarray,
    noise: NormalErrors,
    level: float,
    rng: np.random.Generator,
) -> np.ndarray:
    """Degrade normals (H, W, 3) in camera space inside a mask (H, W)."""
    if level == 0:
        return normals
    from scipy.ndimage import distance_transform_edt, gaussian_filter

    pixel = normals.shape[1] / 512
    reach = max(level * noise.blur * pixel, 0.3)
    channels = [gaussian_filter(normals[..., k], reach) for k in range(3)]
    blurred = np.stack(channels, axis=-1)
    length = np.linalg.norm(blurred, axis=-1)
    # Where the mask extends past the surface, use the nearest normal.
    rows, columns = distance_transform_edt(
        length < 1e-3, return_distances=False, return_indices=True
    )
    blurred = blurred[rows, columns] / np.maximum(length[rows, columns], 1e-9)[..., None]
    axes = [field(rng, mask.shape, noise.tilt_length * pixel) for _ in range(3)]
    turned = blurred + level * noise.tilt / np.sqrt(2) * np.cross(np.stack(axes, -1), blurred)
    if noise.flat:
        turned = turned * np.array([1 - min(level * noise.flat, 1)] * 2 + [1])
    if any(noise.turn):
        turned = turned @ to_matrices(level * np.array(noise.turn)).T
    turned[..., 2] = np.minimum(turned[..., 2], 0)  # visible surfaces face the camera
    turned /= np.maximum(np.linalg.norm(turned, axis=-1, keepdims=True), 1e-9)
    return (turned * (mask > 0.5)[..., None]).astype(np.float32)
