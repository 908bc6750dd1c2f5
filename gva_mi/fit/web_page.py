"""Write an avatar as one web page that plays it: no server, no network, no other file.

``web_page.html`` holds the page's form and shaders, ``web_page.js`` draws. This module packs what
they need into it, compressed:

* of each Gaussian its parameters at rest, the joints that it follows with their weights and the
  weights' derivatives, and its blend shapes, as lists without the zeros;
* of the body's surface the same, and its triangles, for the button "Mesh";
* of each motion the joints' transforms and the blend shapes' coefficients, frame by frame.

So the page evaluates :mod:`gva_mi.avatar.skin_gaussians` with nothing left out but small blend
shapes, and the residual, which avatars have as an ablation only. Most numbers take 16 bits, as
whole multiples of a step that each array has of its own: 15 µm for places, 0.01 % for scales,
0.003/m for a weight's derivative. Between frames the page interpolates transforms linearly.

The page is of our own making because nothing else shows these Gaussians: Spark and PlayCanvas keep
quaternions and scales, and a Gaussian that stretches with the skin is sheared.
"""

from __future__ import annotations

import base64
import gzip
import html
import json
from collections.abc import Sequence
from dataclasses import asdict
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.export import NamedMotion
from gva_mi.avatar.lbs_transforms import MAX_STRETCH, SparseWeights
from gva_mi.avatar.rig import digest
from gva_mi.avatar.skin_gaussians import light_vector
from gva_mi.body.smplx import load_body
from gva_mi.core.atomic import write_bytes
from gva_mi.core.errors import InputError
from gva_mi.fit.renders import AVATAR_SPLATTING, FOCAL_RATIO, ROOM_AROUND, cylinder

# Both chosen: a page below 40 MB, which phones open and people send.
MOST_GAUSSIANS = 200_000
MOST_FRAMES = 5000  # of all motions together
# Of a point: blend shapes at most, and metres of the smallest one. Chosen: the built-in body keeps
# all of its, and one whose 486 shapes move every point keeps the largest.
MOST_SHAPES, SMALLEST_SHAPE = 12, 2e-5
_STEPS = 32767  # of 16 bits, on either side of zero


@torch.no_grad()
def save_page(
    path: Path,
    avatar: Avatar,
    motions: Sequence[NamedMotion],
    title: str,
    surface: bool = True,
) -> None:
    """Write the page, atomically.

    Args:
        path: of the page.
        avatar: any that does not need its residual.
        motions: at least one; the first is played first.
        title: heading of the page.
        surface: whether the page holds the body's surface and its blend shapes.

    Raises:
        InputError: more Gaussians or frames than a page holds.

    Example:
        >>> import tempfile
        >>> from gva_mi.avatar.avatar import AvatarOptions, SeedOptions, seed_avatar
        >>> from gva_mi.body.pose import Pose, Shape
        >>> from gva_mi.body.smplx import load_body
        >>> options = AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(load_body(), Shape(torch.zeros(10)), options=options)
        >>> path = Path(tempfile.mkdtemp()) / "me.html"
        >>> save_page(path, avatar, [NamedMotion("rest", Pose.rest(), fps=30)], "Me")
        >>> path.read_text()[:15]
        '<!doctype html>'
    """
    count, frames = len(avatar.canonical), sum(len(motion.pose) for motion in motions)
    for found, most, what in (
        (count, MOST_GAUSSIANS, "Gaussians"),
        (frames, MOST_FRAMES, "frames of motion"),
    ):
        if found > most:
            raise InputError(f"{path}: a page holds at most {most:,} {what}, not {found:,}")
    about = f"{count:,} Gaussians; made with gva_mi."
    if surface and avatar.rig.body != digest(load_body()):
        about += " The page holds the person's body model, whose licence decides who may have it."
    if avatar.options.residual.enabled:
        about += " The pose residual is left out."
    part = lambda name: (files("gva_mi.fit") / name).read_text("utf-8")
    content = part("web_page.html")
    for name, text in (  # the data last: it is long
        ("title", html.escape(title)),
        ("about", html.escape(about)),
        ("script", part("web_page.js").strip()),
        ("data", base64.b64encode(packed(avatar, motions, surface)).decode()),
    ):
        content = content.replace(f"{{{name}}}", text)
    write_bytes(path, content.encode("utf-8", "xmlcharrefreplace"))


def packed(avatar: Avatar, motions: Sequence[NamedMotion], surface: bool) -> bytes:
    """Return all that the page's script reads, compressed: a length, a JSON of it, and arrays."""
    G, rig, file = avatar.canonical, avatar.rig, _Arrays()
    weights = G.sparse_weights
    if not avatar.options.stretch:
        weights = SparseWeights.of(G.weights, torch.zeros_like(G.slopes))
    file.points("splat", G.means, weights, G.directions if surface else G.directions[..., :0])
    file.fixed("quats", torch.nn.functional.normalize(G.quats, dim=1))
    file.fixed("logScales", G.log_scales)
    file.fixed("opacities", G.opacities)
    file.fixed("colors", G.sh)
    file.exact("joints", rig.joints, "f4")
    file.exact("parents", np.array(rig.parents) % 256, "u1")  # 255: none
    if surface:
        none = torch.zeros(len(rig.vertices), 3, rig.weights.shape[1])
        file.points("mesh", rig.vertices, SparseWeights.of(rig.weights, none), rig.directions)
        file.exact("faces", rig.faces, "u4")
    described = []
    for k, motion in enumerate(motions):
        skeleton = avatar.posed_skeleton(motion.pose)
        file.exact(f"motion{k}Transforms", skeleton.T_world_rest[:, :, :3], "f4")
        file.exact(f"motion{k}Coefficients", skeleton.coefficients, "f4")
        around = {
            name: np.asarray(value).tolist()
            for name, value in asdict(cylinder(rig, motion.pose)).items()
        }
        about = {"name": motion.name, "arrays": f"motion{k}", "fps": motion.fps}
        described.append({**about, "frames": len(motion.pose), **around})
    lit = avatar.options.color == "light"
    return file.compressed(
        light=light_vector(avatar.light)[0].tolist() if lit else None,
        bands=G.sh.shape[1],
        blur=AVATAR_SPLATTING.blur,
        alphaMin=AVATAR_SPLATTING.alpha_min,
        maxStretch=MAX_STRETCH,
        focalRatio=FOCAL_RATIO,
        roomAround=ROOM_AROUND,
        motions=described,
    )


class _Arrays:
    """Arrays one after the other, and what the script has to know of each."""

    def __init__(self) -> None:
        self._described: list[dict[str, Any]] = []
        self._content: list[bytes] = []
        self._size = 0

    def exact(self, name: str, values: Tensor | np.ndarray, kind: str, step: float = 0) -> None:
        """Add an array of a numpy type; the script multiplies it by the step, unless it is 0."""
        content = np.ascontiguousarray(values).astype(f"<{kind}").tobytes()
        count = len(content) // np.dtype(kind).itemsize
        about = {"name": name, "kind": kind, "at": self._size, "count": count, "step": step}
        self._described.append(about)
        self._content.append(content + b"\0" * (-len(content) % 8))
        self._size += len(self._content[-1])

    def fixed(self, name: str, values: Tensor) -> None:
        """Add an array in 16 bits a number; zero stays zero."""
        exact = values.detach().double().numpy()
        step = float(np.abs(exact).max(initial=0)) / _STEPS or 1.0
        self.exact(name, np.round(exact / step), "i2", step)

    def points(self, name: str, means: Tensor, weights: SparseWeights, directions: Tensor) -> None:
        """Add N points at rest, the joints that they follow, and their blend shapes (N, 3, K)."""
        self.fixed(f"{name}Means", means)
        self.exact(f"{name}PairCounts", _counts(weights.gaussians, len(means)), "u1")
        self.exact(f"{name}PairJoints", weights.joints, "u1")
        self.fixed(f"{name}PairWeights", weights.four[:, 0])
        self.fixed(f"{name}PairSlopes", weights.four[:, 1:])
        sizes = directions.abs().amax(1)
        largest = sizes.topk(min(MOST_SHAPES, sizes.shape[1]), dim=1).values[:, -1:]
        points, shapes = ((sizes >= largest) & (sizes > SMALLEST_SHAPE)).nonzero().unbind(1)
        self.exact(f"{name}ShapeCounts", _counts(points, len(means)), "u2")
        self.exact(f"{name}ShapeNumbers", shapes, "u2")
        self.fixed(f"{name}ShapeMetres", directions[points, :, shapes])

    def compressed(self, **about: object) -> bytes:
        """Return everything, with ``about`` in the JSON."""
        text = json.dumps(about | {"arrays": self._described}).encode()
        text += b" " * (-(4 + len(text)) % 8)
        head = np.array([len(text)], "<u4").tobytes() + text
        return gzip.compress(head + b"".join(self._content), mtime=0)  # the same bytes every time


def _counts(of: Tensor, count: int) -> Tensor:
    """Return how often each number below ``count`` occurs."""
    return torch.bincount(of, minlength=count)
