"""Drive an avatar in a Mitsuba scene: open the scene, stand the person in it, render a motion.

The person's upright and front, as :mod:`gva_mi.fit.renders` finds them, become the scene's y axis
and its z axis, turned about y. The ground is what a ray straight down meets below the height of the
scene's camera. The median over the motion of the lowest vertex stands on it: feet of estimated
poses move up and down by a centimetre, and their mean neither floats nor sinks.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.stage import Proxy, Stage, StageOptions
from gva_mi.body.pose import Pose, load_poses
from gva_mi.core.console import Progress, say
from gva_mi.core.errors import InputError
from gva_mi.core.options import Within, options_of
from gva_mi.fit.renders import CameraShot, cylinder
from gva_mi.fit.run_folder import last_surface, trained_poses
from gva_mi.mesh.mesh_scene import load_plugins, pixel_aspect, sensor_of
from gva_mi.splat import Camera

if TYPE_CHECKING:
    import mitsuba as mi

SHIPPED = Path(__file__).parent / "scenes"  # of this package, by name
STANDING_FRAMES = 64  # of a motion that find its lowest vertex; chosen: a second of posing
FAR_CLIP = 1e4  # metres; Mitsuba's own, so that grounds reach the horizon
OTHER_FORMATS = {  # what to do with files that Mitsuba does not read
    ".blend": "Blender's add-on mitsuba-blender exports one",
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz", ".gltf", ".glb", ".fbx"),
                    "import it in Blender, whose add-on mitsuba-blender exports one"),
    **dict.fromkeys((".ply", ".obj"), "name this mesh in one, as a shape"),
}  # fmt: skip
LIMITS = (
    "surfaces are diffuse, light is as fine as the skin's vertices (1 cm), curved mirrors and "
    "glass show the skin, hair is opaque in shadows"
)
Metres = Annotated[float, Within(-1e4, 1e4, unit="metres")]
Turn = Annotated[float, Within(-3600, 3600, unit="degrees")]


@options_of("render")
class SceneOptions(StageOptions):
    """A Mitsuba scene around the person; its sensor is the camera unless another one is given.

    Example:
        >>> SceneOptions(scene=Path("room"), place=(0.3, 0, 20)).light
        'kept'
    """

    # A file of Mitsuba's XML, or the name of a shipped scene: room, sky, studio.
    scene: Path | None = None
    # Where the person stands: x, z, and the angle from the z axis; on the ground there.
    place: tuple[Metres, Metres, Turn] = (0.0, 0.0, 0.0)

    def inputs(self) -> list[object]:
        """Return all that a picture in the scene depends on: options, and files named in it."""
        if self.scene is None:
            return []
        path = scene_path(self.scene)
        named = re.findall(r'"([^"<>]+)"', path.read_text(errors="replace"))
        files = [path.parent / name for name in named if (path.parent / name).is_file()]
        return [path, *files, self.light, self.exposure, self.spp, self.bake, *self.place]


def scene_path(named: Path) -> Path:
    """Return the file of a scene: as named, or a shipped one.

    Example:
        >>> scene_path(Path("studio")).name, scene_path(Path("my/room.xml")).name
        ('studio.xml', 'room.xml')
    """
    shipped = SHIPPED / f"{named}.xml"
    return (
        shipped if shipped.parent == SHIPPED and shipped.exists() and not named.exists() else named
    )


def load_scene(path: Path) -> mi.Scene:
    """Load a scene of Mitsuba's XML, whose parts keep their ids.

    Raises:
        InputError: no such file, another format, or what Mitsuba says is wrong with it.

    Example:
        >>> load_scene(Path("kitchen.blend"))
        Traceback (most recent call last):
        gva_mi.core.errors.InputError: kitchen.blend: expected a scene in Mitsuba's XML; ...
    """
    load_plugins()
    import mitsuba as mi

    if advice := OTHER_FORMATS.get(path.suffix.lower()):
        raise InputError(f"{path}: expected a scene in Mitsuba's XML; {advice}")
    if not path.is_file():
        shipped = ", ".join(sorted(x.stem for x in SHIPPED.glob("*.xml")))
        raise InputError(f"{path}: no such file; shipped scenes are {shipped or 'none'}")
    try:
        scene = mi.load_file(str(path), optimize=False)
    except (RuntimeError, ValueError) as error:
        reason = re.sub(r"^\[\w+\.cpp:\d+\] ", "", str(error).strip())
        raise InputError(f"{path}: Mitsuba cannot load this scene: {reason}") from None
    if not isinstance(scene, mi.Scene):
        raise InputError(f"{path}: expected a scene, got a {type(scene).__name__}")
    return scene


@dataclass(frozen=True)
class StagedMotion:
    """A motion of an avatar in a scene, and who looks.

    Example:
        >>> run = Path("out/demo/run")
        >>> avatar, (motion, *_) = load_avatar(run), load_motion(run, None)  # doctest: +SKIP
        >>> staged = StagedMotion.of(run, avatar, motion, SceneOptions(scene=Path("room")))
        ... # doctest: +SKIP
        >>> [layer] = staged.layers([0], None)  # doctest: +SKIP
    """

    stage: Stage
    motion: Pose
    shots: list[CameraShot]  # cameras in the world of the poses
    sensors: list[mi.Sensor]  # one for all shots, or one for each

    @staticmethod
    def of(
        run: Path, avatar: Avatar, motion: Pose, options: SceneOptions,
        shots: Sequence[CameraShot] | None = None,
    ) -> StagedMotion:  # fmt: skip
        """Open a scene and stand an avatar in it.

        ``shots`` are cameras in the world of the poses; None: the scene's sensor sees each frame.
        """
        path, surface = scene_path(options.scene), last_surface(run)
        filmed = trained_poses(run if run.is_dir() else run.parent)
        scene = load_scene(path)
        import mitsuba as mi
        from gva_mi_plugins.gaussian_splat.scene import SensorCamera

        T = _stand(scene, path, Proxy.of(avatar, surface), motion, options.place)
        sensors = scene.sensors()[:1]
        if shots is not None:
            sampler = sensors[0].sampler() if sensors else {"type": "multijitter"}
            sensors = [mi.load_dict(_sensor(s.camera, T) | {"sampler": sampler}) for s in shots]
        try:
            stage = Stage(
                scene,
                avatar,
                options,
                T_scene_avatar=T,
                surface=surface,
                filmed=None if filmed is None else load_poses(filmed)[0],
                sensor=(sensors or [None])[0],
            )
            if shots is None:
                camera = stage.in_avatars_world(SensorCamera.of(sensors[0]).camera)
                shots = [CameraShot(k, camera) for k in range(len(motion))]
        except ValueError as error:  # of the scene
            reason = re.sub(r"^\w+: ", "", str(error))
            raise InputError(f"{path}: {reason}") from None
        return StagedMotion(stage, motion, list(shots), sensors)

    def layers(self, chosen: Sequence[int], progress: Progress | None) -> Iterator[np.ndarray]:
        """Yield the picture of each chosen shot as an opaque layer, (H, W, 4) float32."""
        for done, k in enumerate(chosen, 1):
            sensor = self.sensors[k % len(self.sensors)]
            picture = np.array(self.stage.render(self.motion[self.shots[k].frame], sensor=sensor))
            yield np.concatenate([picture, np.ones_like(picture[..., :1])], axis=2)
            if progress:
                progress(done, len(chosen))


def _stand(
    scene: mi.Scene, path: Path, proxy: Proxy, motion: Pose, place: tuple[float, float, float]
) -> np.ndarray:
    """Return T_scene_avatar (4, 4) that stands a person on the ground at x, z, turned.

    If a scene has no ground there, the person stands at y = 0, which a printed line says.
    """
    import mitsuba as mi

    x, z, turn = place
    around, angle = cylinder(proxy.avatar.rig, motion), math.radians(turn)
    front = np.array([math.sin(angle), 0, math.cos(angle)])
    up = np.array([0.0, 1, 0])
    axes = lambda up, front: np.stack([np.cross(up, front), up, front], axis=1)
    T = np.eye(4)
    T[:3, :3] = axes(up, front) @ axes(around.up, around.front).T
    chosen = np.unique(np.linspace(0, len(motion) - 1, STANDING_FRAMES).round().astype(int))
    heights = [(proxy.posed(motion[int(k)]).double().numpy() @ T[1, :3]).min() for k in chosen]

    sensors = scene.sensors()
    top = scene.bbox().max.y
    start = sensors[0].world_transform().matrix[1, 3][0] if sensors else top + 1
    below = scene.ray_intersect_preliminary(mi.Ray3f([x, start, z], [0, -1, 0]))
    ground = start - float(below.t[0]) if below.is_valid()[0] else 0.0
    if not below.is_valid()[0]:
        say(f"{path}: no ground below x = {x}, z = {z}: the person stands at y = 0")
    T[:3, 3] = [x, ground - np.median(heights), z] - T[:3, :3] @ around.centre * [1, 0, 1]
    return T


def _sensor(camera: Camera, T_scene_avatar: np.ndarray) -> dict:
    """Return a camera in the world of the poses as a sensor of the scene."""
    if not math.isclose(pixel_aspect(camera), 1, rel_tol=1e-3):
        raise InputError("render: cameras in a scene need square pixels, got fx and fy that differ")
    T_camera_world = camera.T_camera_world @ np.linalg.inv(T_scene_avatar)
    return sensor_of(replace(camera, T_camera_world=T_camera_world)) | {"far_clip": FAR_CLIP}
