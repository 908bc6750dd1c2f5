"""A mesh alone in a Mitsuba scene, whose vertices move."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

if TYPE_CHECKING:
    import mitsuba as mi


def load_plugins() -> None:
    """Register the plugins; set the variant ``llvm_ad_rgb`` if none is set."""
    import gva_mi_plugins
    import mitsuba as mi

    if mi.variant() is None:
        mi.set_variant("llvm_ad_rgb")
    gva_mi_plugins.register()


class MeshInstance:
    """A mesh in a scene of its own.

    It stands there as an instance: Mitsuba builds the ray tracer's tree of an instance four times
    as fast as that of a scene, with fewer cuts, for rays that take as long and hit the same.

    Attributes:
        mesh: the mesh.
        scene: the scene.
    """

    def __init__(self, faces: Tensor, vertices: Tensor) -> None:
        """Build the mesh, of faces (F, 3) and float32 vertices (V, 3), metres."""
        load_plugins()
        import mitsuba as mi

        self.mesh = mesh_of(faces, vertices)
        group = {"type": "shapegroup", "mesh": self.mesh}
        instance = {"type": "instance", "group": {"type": "ref", "id": "group"}}
        self.scene = mi.load_dict({"type": "scene", "group": group, "instance": instance})
        self._parameters = mi.traverse(self.scene)

    def move(self, vertices: Tensor) -> None:
        """Move the mesh to other vertices (V, 3) float32; its tree is built again."""
        self._parameters["group.mesh.vertex_positions"] = _to_mitsuba(vertices)
        self._parameters.update()


def mesh_of(faces: Tensor, vertices: Tensor) -> mi.Mesh:
    """Return the shape ``mesh`` with faces (F, 3) and float32 vertices (V, 3)."""
    import mitsuba as mi

    mesh = mi.Mesh("mesh", len(vertices), len(faces))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = _to_mitsuba(vertices)
    parameters["faces"] = mi.UInt32(faces.to(torch.int32).flatten().numpy().astype(np.uint32))
    parameters.update()
    return mesh


def _to_mitsuba(vertices: Tensor) -> mi.Float:
    """Pass vertices to Mitsuba without a copy: Dr.Jit keeps the tensor's memory alive."""
    import mitsuba as mi

    return mi.Float(vertices.detach().contiguous().view(-1))
