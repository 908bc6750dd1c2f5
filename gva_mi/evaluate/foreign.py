"""The foreign share: how much of an avatar has the colours of a part that it does not belong to.

Where parts of a person touch in a video, Gaussians of one part may learn the colours of the other:
an arm that hangs on a dress becomes dress-coloured, and the dress gets patches of skin. It shows
once the arm is raised. So novel poses are measured, where the true part of each pixel is known.

The person consists of materials m: skin, top, bottom, shoes, hair, or fewer where two have the same
fabric. Their colours in the true pictures have the densities p_m, smoothed histograms of BINS³
cells. A colour c *is* of the material

    1. M(c) = argmax_m p_m(c)    if p_M(c) > SURE p_m(c) for every other m

and of none else. Over the pixels whose true colour is of their own material m, away from the
material's outline by INSIDE pixels, and in which the avatar draws the same part of the body,

    2. foreign = share of pixels for which M(c) is known and differs from m

with c the avatar's colour. The parts are the arms, with hands, and the rest of the person. A pose
that is off shows another part, or none, which scores of the renders tell.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from gva_mi.avatar.avatar import AVATAR_SPLATTING, Avatar
from gva_mi.avatar.held import arm_weights
from gva_mi.body.smplx import BodyModel
from gva_mi.evaluate.figures import Figure
from gva_mi.fit.renders import cut_out, render_frame
from gva_mi.splat import render
from gva_mi.subject.folder import SYNTH
from gva_mi.subject.video import Frame, Video
from gva_mi.synthetic import remake_subject
from gva_mi.synthetic.folder import recorded_options
from gva_mi.synthetic.person.surface import PersonSurface
from gva_mi.synthetic.person.texture import Material
from gva_mi.synthetic.pictures.render import faces_seen

BINS = 16  # cells a channel; chosen: the pixels of one material fill its cells
SMOOTHING = 1.0  # cells, the standard deviation that histograms are smoothed with
SURE = 3.0  # ratio of densities; chosen: fewer than 1 in 4 colours is mistaken
INSIDE = 2  # pixels; chosen: poses in the avatar's world are off by about as much
OWN = 0.9  # share of a pixel that the avatar must draw of a part
FEWEST_PIXELS = 200  # of a material, for a density


def foreign_figures(
    avatar: Avatar, subject: Path, body: BodyModel, true: Video, aligned: Video, alignment: str
) -> Iterator[Figure]:
    """Measure eq. 2 on novel poses; nothing is yielded if the true surface is unknown.

    Args:
        avatar: the fitted avatar.
        subject: the folder of the synthetic subject.
        body: the fitted body model.
        true: the novel poses, in the true world.
        aligned: the same in the avatar's world.
        alignment: the name of that, for the figures.
    """
    if not (subject / SYNTH).is_file() or recorded_options(subject)[1].figure == "anny":
        return  # an "anny" has other vertices than the fitted body
    person, drawn_on = remake_subject(subject, body)
    frames = [k for k in range(len(true)) if k not in true.absent]
    seen = [materials_of(person, drawn_on, frame) for frame in true.frames(frames)]
    pictures = [cut_out(frame) for frame in true.frames(frames)]
    drawn = [_drawn(avatar, frame) for frame in aligned.frames(frames)]
    for region, share in foreign_shares(pictures, drawn, seen).items():
        yield Figure(
            split="novel_pose", region=region, alignment=alignment, metric="foreign", value=share
        )


def foreign_shares(
    pictures: Sequence[np.ndarray],
    drawn: Sequence[tuple[np.ndarray, np.ndarray]],
    seen: Sequence[tuple[np.ndarray, np.ndarray]],
) -> dict[str, float]:
    """Evaluate eq. 2 for arms and the rest, where at least FEWEST_PIXELS are judged.

    Args:
        pictures: the true ones, 8-bit (H, W, 3).
        drawn: the avatar's, and the arms' share of each of its pixels (H, W), NaN: not opaque.
        seen: the true materials and arms, as :func:`materials_of` returns them.
    """
    densities = _densities(pictures, [material for material, _ in seen])
    if len(densities) < 2:
        return {}
    counts = {"arms": np.zeros(2), "rest": np.zeros(2)}
    for picture, (drawing, arm), (material, arms) in zip(pictures, drawn, seen, strict=True):
        judged = _inside(material) & (_material_of(picture, densities) == material)
        found = _material_of(drawing, densities)
        foreign = (found >= 0) & (found != material)
        for region, same in (("arms", arms & (arm > OWN)), ("rest", ~arms & (arm < 1 - OWN))):
            counts[region] += foreign[judged & same].sum(), (judged & same).sum()
    return {k: float(n / total) for k, (n, total) in counts.items() if total >= FEWEST_PIXELS}


def _drawn(avatar: Avatar, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """Render a frame: its 8-bit picture (H, W, 3), and the arms' share of each pixel (H, W).

    The share is NaN where the avatar is not opaque.
    """
    with torch.no_grad():
        gaussians = avatar(frame.pose)
        arms = arm_weights(avatar.canonical.weights)[:, None]
        image = render(replace(gaussians, sh=None, colors=arms), frame.camera, AVATAR_SPLATTING)
    share, alpha = image.color[..., 0].numpy(), image.alpha.numpy()
    opaque = np.where(alpha > OWN, alpha, np.nan)
    return render_frame(avatar, frame.pose, frame.camera), share / opaque


def materials_of(
    person: PersonSurface, drawn_on: BodyModel, frame: Frame
) -> tuple[np.ndarray, np.ndarray]:
    """Return the material (H, W) int of each pixel, -1: none, and which are of arms, (H, W) bool.

    Materials of the same fabric have the same number. Folds are left out.
    """
    vertices = person.skinned(drawn_on, frame.pose)[0]
    face = faces_seen(vertices, person.faces, frame.camera)
    hit = face >= 0
    material = person.material.astype(int)
    if person.look.person.top == person.look.person.bottom:
        material = np.where(material == int(Material.BOTTOM), int(Material.TOP), material)
    arm = (arm_weights(person.weights) > 0.5).numpy()[person.faces].all(1)
    return np.where(hit, material[face], -1), hit & arm[face]


def _inside(material: np.ndarray) -> np.ndarray:
    """Return the pixels away from the outlines of all materials, (H, W) bool."""
    from scipy.ndimage import binary_erosion

    eroded = [binary_erosion(material == k, iterations=INSIDE) for k in np.unique(material)]
    return np.any(eroded, axis=0) & (material >= 0)


def _densities(
    pictures: Sequence[np.ndarray], materials: Sequence[np.ndarray]
) -> dict[int, np.ndarray]:
    """Return p of each material: (BINS, BINS, BINS) of eq. 1."""
    from scipy.ndimage import gaussian_filter

    colors = np.concatenate([p[_inside(m)] for p, m in zip(pictures, materials, strict=True)])
    which = np.concatenate([m[_inside(m)] for m in materials])
    found = {}
    for k in np.unique(which):
        if (which == k).sum() >= FEWEST_PIXELS:
            count, _ = np.histogramdd(colors[which == k], bins=BINS, range=[(0, 256)] * 3)
            found[int(k)] = gaussian_filter(count, SMOOTHING, mode="nearest") / count.sum() + 1e-7
    return found


def _material_of(picture: np.ndarray, densities: dict[int, np.ndarray]) -> np.ndarray:
    """Evaluate eq. 1 for an 8-bit picture (H, W, 3): (H, W) int, -1: not known."""
    cell = tuple(np.moveaxis(picture.astype(int) * BINS // 256, 2, 0))
    p = np.stack([density[cell] for density in densities.values()])
    order = np.argsort(p, axis=0, kind="stable")
    first, second = np.take_along_axis(p, order[-2:], 0)[::-1]
    return np.where(first > SURE * second, np.array(list(densities))[order[-1]], -1)
