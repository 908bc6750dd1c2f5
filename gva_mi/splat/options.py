"""The constants of splatting, in one home: kernels and slow twin read the same ones."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class SplatOptions:
    """Cut-offs of the image formation. The defaults are those of gsplat 1.5.3, which users know."""

    alpha_min: float = 1 / 255  # a pixel-Gaussian pair below it is skipped
    alpha_max: float = 0.999  # alpha is clamped to it
    transmittance_min: float = 1e-4  # a pixel stops before its transmittance falls to this
    blur: float = 0.3  # added to the diagonal of the 2D covariance, square pixels
    near: float = 0.01  # metres; nearer Gaussians are not drawn
    far: float = 1e10  # metres
    radius_min: float = 0.0  # pixels; a Gaussian that reaches no further in x and y is not drawn
    antialiased: bool = False  # what blurring adds in area is taken from the opacity
    depth: bool = True  # whether the depth image is made too; pictures without it are faster

    def __post_init__(self) -> None:
        if not 0 < self.alpha_min < self.alpha_max < 1:
            found = f"{self.alpha_min}, {self.alpha_max}"
            raise ValueError(f"SplatOptions: 0 < alpha_min < alpha_max < 1 is needed, got {found}")
        if not 0 < self.near < self.far:
            raise ValueError(f"SplatOptions: 0 < near < far is needed, got {self.near}, {self.far}")
        if not (self.blur >= 0 and self.radius_min >= 0):
            found = f"{self.blur}, {self.radius_min}"
            raise ValueError(f"SplatOptions: blur and radius_min must be at least 0, got {found}")

    def of_code(self) -> SplatOptions:
        """Those that are constants of the kernels' code; the rest are arguments, as a pose is."""
        return replace(
            self,
            blur=SplatOptions.blur,
            near=SplatOptions.near,
            far=SplatOptions.far,
            radius_min=SplatOptions.radius_min,
        )
