"""The relighting study: avatars in light that their videos do not have, against ground truth.

An avatar is fitted to each case as in :mod:`gva_mi.study.avatar_study`. Its test frames are drawn
in each light of :mod:`gva_mi.synthetic.pictures.lights`. The ground truth is the same subject in
the same light (:func:`gva_mi.synthetic.relit_pictures`). Three ways to light the avatar are
compared:

=====================  =====================================================================
``not relit``          its own colours, in the light of the video
``own light turned``   the light that its colours are linear in, turned to the lamps
``relit``              :class:`gva_mi.avatar.stage.Stage`, in the lamps and sky of the truth
=====================  =====================================================================

The light's strength and white balance are not compared, because a video does not show them: the
colours c of a subject's frames have one gain a channel, the same for all frames,

1. g = Σ T R / Σ R²       R, T: rendered and true linear colours of the person's pixels, on black

and are drawn again as g c. Scores are PSNR of the whole picture on white ("white") and of the
pixels that the true mask covers ("silhouette").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property, partial
from typing import Annotated, Any

import numpy as np
import torch

from gva_mi.avatar.avatar import AVATAR_SPLATTING, Avatar
from gva_mi.avatar.stage import Stage, StageOptions
from gva_mi.body.pose import Pose
from gva_mi.core.console import Progress
from gva_mi.core.errors import InputError
from gva_mi.core.options import PictureSide, PythonOnly, Within, options_of
from gva_mi.core.srgb import decoded, encoded
from gva_mi.core.tasks import Task
from gva_mi.evaluate.figures import Figure
from gva_mi.evaluate.scores import psnr_of
from gva_mi.fit.options import FitOptions
from gva_mi.fit.run_folder import last_surface, under_trained_poses
from gva_mi.mesh.mesh_scene import load_plugins, sensor_of
from gva_mi.refine.sequence import SequenceOptions
from gva_mi.splat import Camera, Gaussians, render
from gva_mi.splat.kernels.sh import C0
from gva_mi.study.avatar_study import AvatarStudy, AvatarStudyOptions, VariantRun
from gva_mi.study.cases import StudyCase
from gva_mi.study.engine import Study
from gva_mi.study.variants import FULL
from gva_mi.study.videos import Work
from gva_mi.synthetic import relit_pictures
from gva_mi.synthetic.options import NovelPictures, VideoFrames
from gva_mi.synthetic.pictures.lights import LIGHTS
from gva_mi.synthetic.pictures.render import Rendering

NOT_RELIT, TURNED, RELIT = "not relit", "own light turned", "relit"  # named as alignments
BOUNCES = 4  # longest path of light, edges; chosen: the truth has one indirect bounce
REGIONS = ("white", "silhouette")


@options_of("study")
class RelightStudyOptions(AvatarStudyOptions):
    """Size of the relighting study: videos and fits are drafts, because light is compared."""

    frames: VideoFrames = 40  # frames of each video
    size: PictureSide = 256  # pixels, width and height of the pictures
    steps: Annotated[int, Within(1, 1_000_000)] = 800  # steps of each fit
    novel: PythonOnly[NovelPictures] = 0
    refine: PythonOnly[SequenceOptions] = SequenceOptions(passes=8, learn=4)
    fit: PythonOnly[FitOptions] = FitOptions(first_steps=0)
    fitted: PythonOnly[bool] = True
    repeats: PythonOnly[Annotated[int, Within(1, 1)]] = 1
    rays: PythonOnly[Annotated[int, Within(1, 65536)]] = 64  # per vertex of the avatar's proxy


@dataclass(frozen=True)
class RelightStudy(Study):
    """A study whose variants are lights."""

    options: RelightStudyOptions
    variants: Sequence[str] = tuple(LIGHTS)
    kind = "relight"

    @cached_property
    def avatars(self) -> AvatarStudy:
        """The study whose avatars are relit."""
        names = [field.name for field in fields(AvatarStudyOptions)]
        options = AvatarStudyOptions(**{name: getattr(self.options, name) for name in names})
        return AvatarStudy(self.folder, self.body, options, [FULL])

    @cached_property
    def made_with(self) -> dict[str, Any]:
        """As of the avatars, and all options."""
        return self.avatars.made_with | {"options": asdict(self.options)}

    def rounds(self, missing: Sequence[tuple[StudyCase, str]]) -> list[Sequence[Task]]:
        """Make, refine and fit each case once, then relight it."""
        of, cases = self.avatars, list(dict.fromkeys(case for case, _ in missing))
        *before, _ = of.rounds([(case, FULL.name) for case in cases])
        fits = [Work(partial(_fit, of.run(case, FULL.name))) for case in cases]
        relit = [
            Work(partial(relight_figures, of.run(case, FULL.name), light, self.options.rays))
            for case, light in missing
        ]
        return [*before, fits, relit]


def lights_named(names: Sequence[str]) -> tuple[str, ...]:
    """Return the named lights, or all.

    Raises:
        InputError: there is no light of a name.
    """
    for name in names:
        if name not in LIGHTS:
            raise InputError(f"study: --lights has no '{name}'; there are: {', '.join(LIGHTS)}")
    return tuple(name for name in LIGHTS if name in names or not names)


def _fit(run: VariantRun, progress: Progress | None = None) -> None:
    run.fit(progress)  # whose avatar is read again, and not sent between processes


def relight_figures(
    run: VariantRun, light: str, rays: int, progress: Progress | None = None
) -> list[Figure]:
    """Relight the test frames of a finished fit, and compare them with the ground truth."""
    avatar, video = run.fit()
    video = under_trained_poses(video, run.out)
    frames = video.splits.test
    truth = relit_pictures(video.folder, run.body, light, frames)
    poses, cameras = [video.pose[k] for k in frames], [video.cameras[k] for k in frames]
    load_plugins()
    path = {"type": "path", "max_depth": BOUNCES}
    scene = {"type": "scene", "sensor": sensor_of(cameras[0]), "path": path}
    stage = Stage(
        scene | LIGHTS[light].emitters(), avatar, StageOptions("scene", bake=rays),
        surface=last_surface(run.out), filmed=video.pose,
    )  # fmt: skip
    ways = {NOT_RELIT: [own_colors(avatar, pose) for pose in poses]}
    avatar.light.data = torch.from_numpy(LIGHTS[light].direction).to(avatar.light)
    ways[TURNED] = [own_colors(avatar, pose) for pose in poses]
    ways[RELIT] = [stage_colors(stage, pose) for pose in poses]
    figures = []
    for name, colors in ways.items():
        with torch.no_grad():
            drawn = [avatar(pose) for pose in poses]
        found = _with_best_gain(drawn, colors, cameras, truth)
        for picture, true in zip(found, truth, strict=True):
            for region in REGIONS:
                chosen = true.mask > (0.5 if region == "silhouette" else -1)
                levels = np.round(255 * picture) - np.round(255 * true.color)
                error = float(np.square(levels)[chosen].mean())
                figures.append(
                    Figure(
                        split="test", region=region, alignment=name, metric="PSNR, dB",
                        value=psnr_of(error),
                    )
                )  # fmt: skip
    return figures


@torch.no_grad()
def own_colors(avatar: Avatar, pose: Pose) -> np.ndarray:
    """Return the avatar's own colours in a pose, linear (N, 3)."""
    return decoded((avatar(pose).sh[:, 0] * C0 + 0.5).relu().numpy())


def stage_colors(stage: Stage, pose: Pose) -> np.ndarray:
    """Return the colours of a stage's avatar in a pose, linear (N, 3)."""
    stage.place(pose)
    return (stage.albedo * stage.light()).numpy()


def _with_best_gain(
    drawn: Sequence[Gaussians],
    colors: Sequence[np.ndarray],
    cameras: Sequence[Camera],
    truth: Sequence[Rendering],
) -> list[np.ndarray]:
    """Draw frames in linear colours, times the gain of eq. 1, on white: (H, W, 3) in [0, 1]."""

    def pictures(gain: np.ndarray, background: float) -> list[np.ndarray]:
        lit = [torch.from_numpy(encoded(gain * c).astype(np.float32)) for c in colors]
        parts, behind = zip(drawn, lit, cameras, strict=True), torch.full((3,), background)
        seen = (
            render(replace(g, sh=None, colors=c), camera, AVATAR_SPLATTING, behind)
            for g, c, camera in parts
        )
        return [image.color.numpy().clip(0, 1) for image in seen]

    inside = [true.mask > 0.5 for true in truth]
    of_person = lambda images: np.concatenate(
        [decoded(image[chosen].clip(0)) for image, chosen in zip(images, inside, strict=True)]
    )
    on_black = [true.color - (1 - true.mask[..., None]) for true in truth]
    R, T = of_person(pictures(np.ones(3), 0.0)), of_person(on_black)
    return pictures((T * R).sum(0) / np.square(R).sum(0), 1.0)
