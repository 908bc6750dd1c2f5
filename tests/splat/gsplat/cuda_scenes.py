"""The scenes and cases of ``cuda_references.npz``: numpy only, no gva_mi.

A scene is a dictionary of the arrays that ``rasterization`` takes, float32, with the size of its
pictures. A case is a scene and keyword arguments. Both are stored in the file, and the test reads
them there: this module only made them.
"""

import numpy as np

SIZE = 53, 37  # px, no multiple of any tile
EYES = np.array([[0.4, 0.5, 3.2], [-1.5, 0.3, 2.6]])  # of the two cameras, m
TARGETS = np.array([[0.0, 0.0, 0.0], [0.1, 0.05, 0.0]])
PINHOLES = [[55.0, 0, 24.2], [0, 46, 19.7], [0, 0, 1]], [[48.0, 0, 28.9], [0, 50, 15.4], [0, 0, 1]]


def look_at(eye, target):
    """Return the (4, 4) matrix from the world, y up, to a camera with x right and y down."""
    unit = lambda v: v / np.linalg.norm(v)
    forward = unit(target - eye)
    right = unit(np.cross(forward, [0.0, 1.0, 0.0]))
    T = np.eye(4)
    T[:3, :3] = right, np.cross(forward, right), forward
    T[:3, 3] = -T[:3, :3] @ eye
    return T


def rotations(quats):
    """Return the rotation matrices (N, 3, 3) of quaternions (N, 4) wxyz of any length."""
    w, x, y, z = (quats / np.linalg.norm(quats, axis=1, keepdims=True)).T
    rows = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]
    rows += [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]
    rows += [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
    return np.stack(rows, axis=1).reshape(-1, 3, 3)


def cameras(Ks=PINHOLES):
    views = np.stack([look_at(*pair) for pair in zip(EYES, TARGETS, strict=True)])
    return {"viewmats": views, "Ks": np.array(Ks, dtype=np.float64)}


def cloud(seed, count, opacity=(0.1, 0.75), channels=3, spread=0.7):
    """Make random Gaussians around the origin, with quaternions of length 0.3 to 3."""
    random = np.random.RandomState(seed)
    quats = random.randn(count, 4)
    quats *= random.uniform(0.3, 3, (count, 1)) / np.linalg.norm(quats, axis=1, keepdims=True)
    return {
        "means": random.randn(count, 3) * spread,
        "quats": quats,
        "scales": np.exp(random.uniform(np.log(0.03), np.log(0.25), (count, 3))),
        "opacities": random.uniform(*opacity, count),
        "colors": random.rand(count, channels),
        "backgrounds": random.rand(2, channels),
    }


def with_extremes(scene):
    """Overwrite the first Gaussians by those that cut-offs and limits are made for."""
    T = look_at(EYES[0], TARGETS[0])
    place = lambda x, y, z: T[:3, :3].T @ (np.array([x, y, z]) - T[:3, 3])  # in the first camera
    special = [  # mean, scales, opacity
        (place(0, 0, -0.5), (0.3, 0.3, 0.3), 0.6),  # behind it
        (place(0.1, 0, 0.005), (0.01, 0.01, 0.01), 0.6),  # in front of the near plane
        (place(1.45, 0.2, 3), (0.3, 0.2, 0.25), 0.6),  # across the right border
        (place(-2.2, 0.3, 3.05), (0.9, 0.4, 0.5), 0.5),  # centre beyond the linearisation's limit
        (place(0.5, 1.9, 2.8), (0.3, 0.8, 0.3), 0.5),  # the same, below
        (place(-4, 0, 2.95), (0.2, 0.2, 0.2), 0.6),  # outside
        (place(0.2, 0.1, 4), (1.6, 1.1, 1.4), 0.3),  # larger than the picture
        (place(0.1, 0.2, 2.9), (0.45, 0.004, 0.006), 0.7),  # a needle
        (place(-0.4, 0.1, 3.12), (0.3, 0.2, 0.0), 0.6),  # flat
        (place(0.4, -0.3, 2.7), (1e-4, 1e-4, 1e-4), 0.7),  # a point
        (place(0.0, 0.3, 2.5), (0.3, 0.2, 0.3), 0.003),  # too transparent to be drawn
        (place(0.3, 0.3, 2.4), (0.3, 0.3, 0.2), 0.006),  # barely drawn
        (place(-0.6, -0.3, 3.3), (0.12, 0.1, 0.1), 0.93),  # nearly opaque
    ]
    means, scales, opacities = (np.array(column) for column in zip(*special, strict=True))
    n = len(special)
    for name, rows in (("means", means), ("scales", scales), ("opacities", opacities)):
        scene[name][:n] = rows
    return scene


def harmonics(seed, count):
    """A cloud whose colours are 25 coefficients a channel, some of them dark enough to clamp."""
    coefficients = np.random.RandomState(seed + 1).randn(count, 25, 3) * 0.35
    return cloud(seed, count) | {"colors": coefficients}


def covariances():
    """A cloud given by covariances; their lower triangles are zero, for nobody reads them."""
    scene = cloud(5, 30)
    axes = rotations(scene.pop("quats")) * scene.pop("scales")[:, None]
    return scene | {"covars": np.triu(axes @ axes.transpose(0, 2, 1))} | cameras()


def planes():
    """Gaussians exactly on the near and far planes (2 m, 4 m) and in pairs of equal depth."""
    scene = cloud(6, 24, spread=0.5)
    scene["means"][:, 2] = np.linspace(1.7, 4.3, 24)
    scene["means"][[3, 7, 11], 2] = 2.0
    scene["means"][[5, 20, 2], 2] = 4.0
    scene["means"][[9, 14, 15, 16], 2] = 3.0
    scene["means"] = np.round(scene["means"] * 64) / 64
    views = np.stack([np.eye(4), np.eye(4)])
    views[1, :3, 3] = 0.25, -0.125, 0.0
    return scene | cameras() | {"viewmats": views}


def opaque():
    """A stack of opaque Gaussians: alpha is clamped, and pixels stop early."""
    scene = cloud(7, 34, opacity=(0.9, 1.0), spread=0.5)
    scene["scales"] = scene["scales"] + 0.1
    scene["opacities"][::4] = 1
    return scene | cameras()


def near_axis():
    """Gaussians whose centres lie nearly or exactly on the axis of a fisheye."""
    scene = cloud(8, 12)
    distances = np.array([0, 1e-7, 1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.06, 0.1, 0.2])
    angles = np.arange(12) * 2.4
    scene["means"] = np.stack(
        [distances * np.cos(angles), distances * np.sin(angles), np.linspace(1, 3, 12)], axis=1
    )
    return scene | cameras(FISHEYES) | {"viewmats": np.stack([np.eye(4), np.eye(4)])}


def batch(opacities_alike):
    """Two scenes of their own, each with two cameras of its own.

    gsplat 1.5.3 mixes the gradients of the two where they have fewer than 32 Gaussians, a warp.
    Packed, it finds the radii of both by the opacities of the first: ``opacities_alike``.
    """
    parts = [cloud(9 + b, 34) | cameras() for b in range(2)]
    parts[1]["viewmats"][:, 0, 3] += 0.2
    parts[1]["Ks"][:, 0, 0] += 6
    if opacities_alike:
        parts[1]["opacities"] = parts[0]["opacities"]
    return {name: np.stack([part[name] for part in parts]) for name in parts[0]}


FISHEYES = [[30.0, 0, 24.2], [0, 26, 19.7], [0, 0, 1]], [[22.0, 0, 28.9], [0, 25, 15.4], [0, 0, 1]]
ORTHOS = [[16.0, 0, 24.2], [0, 14, 19.7], [0, 0, 1]], [[12.0, 0, 28.9], [0, 15, 15.4], [0, 0, 1]]


def scenes():
    """Return all scenes by name; the arrays are float32."""
    features = cloud(4, 24, channels=5)
    of_cameras = np.random.RandomState(40).randn(2, 24, 5)
    made = {
        "extremes": with_extremes(cloud(1, 42)) | cameras(),
        "ortho": with_extremes(cloud(2, 32)) | cameras(ORTHOS),
        "fisheye": with_extremes(cloud(3, 32)) | cameras(FISHEYES),
        "features": features | {"colors": of_cameras} | cameras(),
        "covariances": covariances(),
        "planes": planes(),
        "opaque": opaque(),
        "near axis": near_axis(),
        "harmonics": harmonics(11, 16) | cameras(),
        "batch": batch(opacities_alike=False),
        "batch, opacities alike": batch(opacities_alike=True),
    }
    single = lambda scene: {k: np.ascontiguousarray(v, np.float32) for k, v in scene.items()}
    return {name: single(scene) for name, scene in made.items()}


# name: scene, arguments. Two combinations are left out, because gsplat 1.5.3 fails: packed with
# backgrounds, and packed with ``segmented`` and several cameras.
CASES = {
    "colors": ("extremes", {"packed": False, "absgrad": True}),
    "colors, packed": (
        "extremes", {"backgrounds": None, "absgrad": True, "render_mode": "RGB+ED"}
    ),
    "antialiased": ("extremes", {"packed": False, "rasterize_mode": "antialiased"}),
    "antialiased, packed": (
        "extremes",
        {"backgrounds": None, "rasterize_mode": "antialiased", "render_mode": "RGB+D"},
    ),
    "depth": ("extremes", {"packed": False, "render_mode": "D", "eps2d": 1.5}),
    "expected depth": (
        "extremes", {"backgrounds": None, "render_mode": "ED", "radius_clip": 5.0}
    ),
    "ortho": ("ortho", {"packed": False, "camera_model": "ortho", "render_mode": "RGB+D"}),
    "fisheye": ("fisheye", {"packed": False, "camera_model": "fisheye", "render_mode": "RGB+D"}),
    "fisheye, antialiased": (
        "fisheye",
        {"backgrounds": None, "camera_model": "fisheye", "rasterize_mode": "antialiased"},
    ),
    "fisheye, near its axis": ("near axis", {"packed": False, "camera_model": "fisheye"}),
    "features of each camera": (
        "features", {"packed": False, "tile_size": 8, "channel_chunk": 3}
    ),
    "covariances": ("covariances", {"backgrounds": None, "render_mode": "RGB+D"}),
    "planes": ("planes", {"packed": False, "near_plane": 2.0, "far_plane": 4.0}),
    "opaque": ("opaque", {"packed": False, "absgrad": True, "render_mode": "RGB+D"}),
    "harmonics of degree 4": ("harmonics", {"sh_degree": 4, "packed": False, "absgrad": True}),
    "harmonics of degree 3": ("harmonics", {"sh_degree": 3, "packed": False}),
    "harmonics of degree 1": ("harmonics", {"sh_degree": 1, "backgrounds": None}),
    "batch": ("batch", {"packed": False}),
    "batch, packed": ("batch, opacities alike", {"backgrounds": None}),
}  # fmt: skip
