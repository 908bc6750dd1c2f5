"""The body's surface before a fit: its first colours, bare skin, and clothes where parts touch.

A fit starts from the colours c of the body's vertices v that the training frames k show:

    1. Σ_k w_vk (I_k(π_k(x_vk)) - c_v) = λ (Δ c)_v,    w_vk = S_k(π_k(x_vk)) max(0, -n_vk · d_vk)²

with x the posed vertex, n its normal, d the direction from the camera to it, π the projection, I
the picture, S the mask, and Δ the uniform Laplacian. Surfaces seen from the front count fully,
grazing ones hardly. If a limb hides a vertex in some frames, the other frames outweigh them, and
the fit corrects the rest. What no frame shows takes the colours around it. From grey, Adam's steps
of constant size would take hundreds of iterations to reach black or white.

The refinement takes what the pictures show outside of its naked body for clothes, also where an arm
is bare and the body's shape is wrong. Bare skin has no clothes. It has the colour of the person's
own face: with the chroma

    2. χ = (log R - log G, log B - log G)

and the medians m of χ and g of log G over cheeks, nose and mouth, a vertex looks like skin if

    3. max |χ - m| < SKIN_CHROMA    and    |log G - g| < SKIN_BRIGHTNESS

A limb is bare where most vertices of BARE_ROWS successive rows look like skin. A skirt or a wide
sleeve in the colour of skin is cloth: it stands off the body farther than errors of poses and
shapes do, and it hangs from the trunk, so no row from there to the trunk is bare. Tight cloth in
the colour of skin counts as skin. If the face never looks toward the camera, no limb is bare.

Where parts touch in the pictures, an arm beside the trunk looks like clothes of the trunk. Clothes
show where the surface is the outline of the person or of a part, so a vertex v knows them from
frames in which it is seen, grazing, and away from a contact (:mod:`gva_mi.fit.completion`):

    4. e_v = Σ_k seen_kv (1 - |n_kv · d_kv|)² q_kv

The height D · n of their displacement, with the normal n at rest, gives way to the solution h of

    5. e_v (h_v - D_v · n_v) = μ ē (Δ h)_v

with ē the mean of e: what no frame tells takes the height of the clothes around it. How well frames
tell the clothes is

    6. t_v = 1 - exp(-e_v / (TOLD_SHARE ē))

Where t is small, the fit holds Gaussians closer to the clothes (:mod:`gva_mi.avatar.held`).
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from gva_mi.avatar.avatar import AvatarOptions, seed_avatar
from gva_mi.avatar.canonical import SeedOptions
from gva_mi.avatar.held import arm_weights
from gva_mi.body.face import from_eyes
from gva_mi.body.pose import JOINTS, SIDES
from gva_mi.body.smplx import BodyModel, Rest
from gva_mi.fit.completion import contact_free
from gva_mi.mesh.mesh_scene import seen_vertices
from gva_mi.mesh.surface import as_scipy, uniform_laplacian, vertex_normals
from gva_mi.subject.splits import spread
from gva_mi.subject.video import Frame, Video

UNSEEN_COLOR = 0.5  # in [0, 1], of the whole person if no frame shows it; chosen: grey
VERTEX_SMOOTHNESS = 0.01  # λ of eq. 1, frames; chosen: far less than one frame that sees a vertex
COLOR_FRAMES = 64  # at most, of eq. 1; chosen: a side is then seen in a dozen of them
CLOTHES_SMOOTHNESS = 0.05  # μ of eq. 5; chosen: a vertex that a few frames tell keeps its clothes
TOLD_SHARE = 0.3  # of eq. 6; chosen by eye on a rendered person with hands on her dress
SOME_FRAMES = 32  # at most, of eq. 4, and in which the face is looked for
FAINT = 1e-6  # of the mean of e, so that eq. 5 has one solution
MEAN_COLOR_WEIGHT = 1e-6  # frames; chosen: only decides where nothing else does


@torch.no_grad()
def seen_colors(video: Video, body: BodyModel, offsets: Tensor | None = None) -> Tensor:
    """Return colours of the body's vertices, (V, 3), as training frames show them.

    ``offsets`` (V, 3) displace the rest surface, metres.
    """
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    total = torch.zeros(len(body.v_template), 3, dtype=torch.float64)
    weight = torch.zeros(len(body.v_template), 1, dtype=torch.float64)
    for frame in video.frames(spread(video.splits.train, COLOR_FRAMES)):
        vertices = body(frame.pose, video.shape, offsets).vertices[0]
        color, seen = _frame_colors(frame, vertices, vertex_normals(vertices, body.faces))
        total += seen * color
        weight += seen
    # Every vertex tends a little to the mean of all, also one that is connected to none of these.
    mean = total.sum(0) / weight.sum() if weight.sum() > 0 else torch.full((3,), UNSEEN_COLOR)
    total, weight = total + MEAN_COLOR_WEIGHT * mean, weight[:, 0] + MEAN_COLOR_WEIGHT
    smooth = VERTEX_SMOOTHNESS * as_scipy(uniform_laplacian(body.faces.numpy(), len(weight)))
    colors = splu((diags_array(weight.numpy()) + smooth).tocsc()).solve(total.numpy())
    return torch.from_numpy(colors).to(body.v_template)


def _frame_colors(frame: Frame, vertices: Tensor, normals: Tensor) -> tuple[Tensor, Tensor]:
    """Return one frame's colours (V, 3) of the vertices, and their weights (V, 1)."""
    camera, image = frame.camera, torch.from_numpy(frame.image)
    T = torch.tensor(camera.T_camera_world, dtype=vertices.dtype)
    x = vertices @ T[:3, :3].T + T[:3, 3]
    before = x[:, 2] > 1e-3
    z = x[:, 2].clamp_min(1e-3)
    column = (camera.fx * x[:, 0] / z + camera.cx).floor().long()
    row = (camera.fy * x[:, 1] / z + camera.cy).floor().long()
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height) & before
    column, row = column.clamp(0, camera.width - 1), row.clamp(0, camera.height - 1)
    toward = torch.nn.functional.normalize(x, dim=1)
    facing = -(normals @ T[:3, :3].T * toward).sum(1)
    mask = torch.from_numpy(frame.mask if frame.overlay is None else frame.mask * ~frame.overlay)
    mask = mask[row, column]
    return image[row, column], (mask * inside * facing.clamp_min(0).square())[:, None]


# Of eq. 3. Chosen on three rendered persons: tan and shading of one person's skin lie within, and
# cloths in other colours do not.
SKIN_CHROMA = 0.2
SKIN_BRIGHTNESS = 1.0  # a factor of e: from light to shade
BARE_ROWS = 5  # a shorter stretch is a pattern or a shadow
LIMB_ROW = 0.02  # metres along a limb, of one row of vertices; chosen: a row has some 20 of them
# Cloth is loose where such a share of a row is displaced by more than so many metres. Chosen:
# hems of three rendered persons' skirts are displaced by 6 cm and more, bare limbs by less than 4.
LOOSE_CLOTH, LOOSE_SHARE = 0.04, 0.1
DARKEST = 0.01  # of a channel, so that it has a logarithm; chosen: below any skin
CUFF = 0.04  # metres over which bareness falls to zero at a sleeve; chosen: shorter than a cuff
TOWARD_CAMERA = 0.3  # mean cosine of a face that a frame shows; chosen: within some 70 degrees


@torch.no_grad()
def bare_skin(colors: Tensor, video: Video, body: BodyModel, offsets: Tensor) -> Tensor:
    """Return how bare each vertex of arms and legs is, (V,) in [0, 1]; 0 elsewhere.

    Args:
        colors: (V, 3) of the vertices, sRGB in [0, 1]: :func:`seen_colors`.
        video: of which training frames must show the face.
        body: the body model.
        offsets: (V, 3) displacement of the rest surface found by the refinement, metres.
    """
    rest, found = body.rest(video.shape), torch.zeros(len(colors))
    chroma, bright = _chroma(colors)
    face = _face(body, rest)
    if not any(_looks_here(video, k, body, face) for k in spread(video.splits.train, SOME_FRAMES)):
        return found
    like_skin = (chroma - chroma[face].median(0).values).abs().amax(1) < SKIN_CHROMA
    like_skin &= (bright - bright[face].median()).abs() < SKIN_BRIGHTNESS
    far = offsets.norm(dim=1) > LOOSE_CLOTH
    for side, sign in zip(SIDES, (1, -1), strict=True):  # the left is at x > 0
        at = lambda joint, side=side: JOINTS.index(f"{side}_{joint}")
        arm = (arm_weights(body.weights) > 0.5) & (sign * rest.vertices[:, 0] > 0)
        leg = body.weights[:, [at("hip"), at("knee"), at("ankle"), at("foot")]].sum(1) > 0.5
        x = rest.joints[at("wrist"), 0].abs() - rest.vertices[:, 0].abs()
        y = rest.vertices[:, 1] - rest.joints[at("ankle"), 1]
        for limb, along in ((arm, x), (leg, y)):
            found[limb] = _bareness(along[limb], like_skin[limb], far[limb])
    return found


def _face(body: BodyModel, rest: Rest) -> Tensor:
    """Return the vertices of cheeks, nose and mouth, (V,) bool."""
    x, y, z = from_eyes(rest).T
    head = body.weights[:, [JOINTS.index("head"), JOINTS.index("jaw")]].sum(1) > 0.5
    return head & (x.abs() < 1) & (y < -0.2) & (y > -1.2) & (z > -1)


def _looks_here(video: Video, frame: int, body: BodyModel, face: Tensor) -> bool:
    """Return whether the vertices of the face (V,) bool look toward the camera in a frame."""
    vertices = body(video.pose[frame], video.shape).vertices[0]
    eye = torch.tensor(video.cameras[frame].position, dtype=vertices.dtype)
    toward = normalize(eye - vertices, dim=1) * vertex_normals(vertices, body.faces)
    return bool(toward[face].sum(1).mean() > TOWARD_CAMERA)


def _chroma(colors: Tensor) -> tuple[Tensor, Tensor]:
    """Return χ of eq. 2, (V, 2), and log G, (V,)."""
    red, green, blue = colors.clamp_min(DARKEST).log().T
    return torch.stack([red - green, blue - green], dim=1), green


def _bareness(along: Tensor, like_skin: Tensor, far: Tensor) -> Tensor:
    """Return how bare the vertices of one limb are (n,).

    ``along`` (n,) are places on the limb toward the trunk, metres; ``far`` (n,) bool are the
    vertices that are displaced by more than LOOSE_CLOTH.
    """
    from scipy.ndimage import binary_opening, distance_transform_edt

    row = (along / LIMB_ROW).floor().long()
    row = (row - row.min()).numpy()
    share = lambda chosen: np.bincount(row, chosen.numpy()) / np.maximum(np.bincount(row), 1)
    loose = np.maximum.accumulate(share(far) > LOOSE_SHARE)
    skin = (share(like_skin) > 0.5) & ~loose
    bare = binary_opening(np.pad(skin, BARE_ROWS, mode="edge"), np.ones(BARE_ROWS))
    from_cloth = LIMB_ROW * distance_transform_edt(bare)[BARE_ROWS:-BARE_ROWS]
    return torch.from_numpy(np.minimum(from_cloth / CUFF, 1)[row]).to(along)


@torch.no_grad()
def clothes_beside_contacts(
    video: Video, body: BodyModel, offsets: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the displacement of the clothes with the heights of eq. 5, and how well it is told.

    Args:
        video: of which training frames are used.
        body: the body model.
        offsets: (V, 3) the displacement D, metres. Where it is zero it stays.

    Returns:
        The displacement (V, 3), metres, and t of eq. 6 (V,) in [0, 1].
    """
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    on_vertices = AvatarOptions(seed=SeedOptions(count=0))
    avatar = seed_avatar(body, video.shape, offsets, on_vertices)
    e = torch.zeros(len(offsets))
    for k in spread(video.splits.train, SOME_FRAMES):
        pose, camera = video.pose[k], video.cameras[k]
        vertices = body(pose, video.shape, offsets).vertices[0]
        eye = torch.tensor(camera.position, dtype=vertices.dtype)
        facing = vertex_normals(vertices, body.faces) * normalize(vertices - eye, dim=1)
        seen = seen_vertices(vertices, body.faces, camera.position[None])[0]
        clear = contact_free(avatar(pose), avatar.canonical.means, camera)
        e += seen * (1 - facing.sum(1).abs()).square() * clear
    e = e / e.mean().clamp_min(1e-6)
    weights = e.double().numpy() + FAINT
    smooth = CLOTHES_SMOOTHNESS * as_scipy(uniform_laplacian(body.faces.numpy(), len(e)))
    normals = vertex_normals(body.rest(video.shape).vertices, body.faces)
    given = (offsets * normals).sum(1)
    heights = splu((diags_array(weights) + smooth).tocsc()).solve(weights * given.double().numpy())
    change = (torch.from_numpy(heights).to(given) - given) * (offsets != 0).any(1)
    return offsets + change[:, None] * normals, 1 - torch.exp(-e / TOLD_SHARE)
