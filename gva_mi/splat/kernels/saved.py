"""State that a forward pass saves for its adjoint and tangent, and the adjoint's result."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from drjit import ArrayBase as Array

from gva_mi.splat.camera import Camera
from gva_mi.splat.kernels import chunks
from gva_mi.splat.kernels.camera_arrays import CameraArrays
from gva_mi.splat.kernels.inputs import GradientMemory, Inputs, Plan
from gva_mi.splat.kernels.planes import Planes, SavedPixels
from gva_mi.splat.kernels.project import ProjectedMemory
from gva_mi.splat.kernels.tiles import Grid, Layout, Lists


@dataclass(frozen=True)
class SavedState:
    """A picture, with the forward pass's state that its adjoint and tangent need."""

    inputs: Inputs
    plan: Plan
    camera: Camera
    view: CameraArrays
    background: list[Array]  # D
    layout: Layout
    grid: Grid
    planes: Planes
    projected: ProjectedMemory | None  # None if there is no Gaussian
    lists: Lists | None  # None if none is drawn
    saved_pixels: SavedPixels | None
    stop: Array | None  # where each lane of blend stopped

    def backgrounds(self) -> list[list[Array]]:
        """The background of each chunk."""
        return chunks.split_background(self.background, self.plan.formats)


@dataclass(frozen=True)
class Gradients:
    """Result of :func:`render_adjoint`; None for a gradient that was not requested."""

    gaussians: GradientMemory
    background: list[float]  # D
    T_camera_world: np.ndarray | None  # (4, 4)
    K: np.ndarray | None  # (3, 3)

    def named(self) -> Iterator[tuple[str, Array]]:
        """Yield the gradients by the Gaussians' arrays that were requested, by name."""
        g = self.gaussians
        parts = {"means": g.means, "opacities": g.opacities, "colors": g.colors}
        parts |= {} if g.geometry is None else vars(g.geometry)
        yield from ((name, array) for name, array in parts.items() if array is not None)
