"""Pictures of the documentation that show the avatar of the demo, and one that shows Eq. 8.

    python docs/gallery_pictures.py DEMO OUT
    python docs/gallery_pictures.py --eq8 SUBJECT OUT

DEMO is the folder of ``gva-mi demo``; ``overview.png``, ``scenes.png``, ``check.png``,
``motions.png`` and ``exports.png`` are written into OUT. SUBJECT is a synthetic subject;
``eq8.png`` is written.

The overview shows what an avatar is made of, and what it looks like in new poses. Above: a frame
that training left out, its normals, the Gaussians drawn small, and the avatar from other sides.
Below: the ground truth beside the render in two poses that are not in the video, and a raised hand.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from gva_mi import app
from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import JOINTS, Pose, load_poses, save_poses
from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.body.so3 import to_matrix, to_rotvec
from gva_mi.evaluate.measure import SplitView
from gva_mi.evaluate.pictures import shown_views, turntable
from gva_mi.evaluate.pose_errors import pose_errors
from gva_mi.evaluate.regions import person_box
from gva_mi.fit import paper, run_folder
from gva_mi.fit.renders import CameraPath, cut_out, render_frame
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.mesh.overlay import overlay
from gva_mi.refine import SequenceOptions, refine
from gva_mi.refine.image_evidence import MaskAndNormals, common_scale
from gva_mi.splat import look_at, render
from gva_mi.splat.axes import with_axes
from gva_mi.subject.folder import REFINED_POSES
from gva_mi.subject.ground_truth import GroundTruth, load_ground_truth
from gva_mi.subject.normals import normal_colors
from gva_mi.subject.pictures import in_8_bits, read_image
from gva_mi.subject.splits import spread
from gva_mi.subject.video import Video, load_video
from gva_mi.synthetic import SynthOptions, make_subject

# Sizes are chosen by eye, for a page of the site.
ROW_HEIGHT = 440  # pixels of a row of the overview
SIDE_VIEWS = 3  # other sides of the avatar in the overview
NEW_POSE_SCALE = 2  # size of renders in new poses, relative to the video's pictures
VIEW_SIZE = (240, 340)  # width and height in pixels of a view of motions.png and exports.png
VIEWS = 6  # of each of the two
# Scenes of the package in scenes.png, with the frame of the novel poses and the exposure in stops.
SCENES = (("room", 0, 0.7), ("studio", 4, 0), ("sky", 6, 0))
SCENE_RAYS = 256  # per pixel
SCENE_SIDE = 400  # pixels, of each picture


def gva_mi(*words: str | Path | float) -> None:
    """Run a command of gva-mi."""
    command = [sys.executable, "-m", "gva_mi", *map(str, words)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def in_a_row(pictures: list[Path]) -> np.ndarray:
    """Crop pictures to their content, all to the same rows, and put them side by side."""
    images = [read_image(path, 3) for path in pictures]
    drawn = [image.min(-1) < 250 for image in images]
    all_rows, cut = person_box(np.any(drawn, axis=0)), []
    for image, inside in zip(images, drawn, strict=True):
        own = person_box(inside)
        cut.append(image[all_rows.top : all_rows.bottom, own.left : own.right])
    return np.concatenate(cut, axis=1)


def save(image: np.ndarray, out: Path) -> None:
    """Write a picture in 200 colours, which keeps the repository small."""
    Image.fromarray(image).quantize(200, dither=Image.Dither.NONE).save(out, optimize=True)


def motions(run: Path, folder: Path) -> list[Path]:
    """Render the avatar in the dance of another subject."""
    dancer = folder / "dancer"
    options = SynthOptions(
        motion="dance", frames=VIEWS, size=32, samples=1, bare=True,
        novel_poses=0, novel_views=0,
    )  # fmt: skip
    make_subject(dancer, options, load_body())
    out = folder / "motions"
    app.render(run, out, CameraPath("static", size=VIEW_SIZE), poses=dancer / "truth/poses.npz")
    return sorted(out.glob("*.png"))


def exports(run: Path, folder: Path) -> list[Path]:
    """Export an avatar without its rig, and render the file from all sides."""
    alone = folder / "alone.npz"
    gva_mi("export", run, "--no-rig", "--out", alone)
    out = folder / "exports"
    app.render(alone, out, CameraPath("turntable", VIEWS, size=VIEW_SIZE), poses=run / "poses.npz")
    return sorted(out.glob("*.png"))


def scenes(demo: Path, folder: Path) -> np.ndarray:
    """Render the avatar in the light of the package's scenes, in poses that its video has not."""
    poses, shape = load_poses(demo / "subject/truth/novel_pose/poses.npz")
    pictures = []
    for name, frame, exposure in SCENES:
        pose = folder / f"{name}.npz"
        save_poses(pose, poses[frame], shape, stage=2)
        gva_mi(
            "render", demo / "run", "--poses", pose, "--scene", name, "--light", "scene",
            "--exposure", exposure, "--spp", SCENE_RAYS, "--out", folder / name,
        )  # fmt: skip
        image = Image.open(folder / name / "000000.png")
        pictures.append(image.resize((SCENE_SIDE, SCENE_SIDE), Image.Resampling.LANCZOS))
    return np.concatenate(pictures, axis=1)


def overview(avatar: Avatar, video: Video) -> np.ndarray:
    """Return the picture, 8-bit (H, W, 3), on white.

    Args:
        avatar: to show.
        video: opened with the poses that the avatar was trained under.
    """
    rows = [list(_made_of(avatar, video))]
    if (view := shown_views(avatar, video, load_body()).get("novel_pose")) is not None:
        rows.append(list(_new_poses(avatar, view)))
    return _stacked([np.concatenate([_scaled(part) for part in row], axis=1) for row in rows])


def _made_of(avatar: Avatar, video: Video) -> Iterator[np.ndarray]:
    frame = video.with_true_mask(video[(video.splits.test or video.splits.train)[0]])
    yield cut_out(frame)
    if frame.normals is not None:
        inside = frame.mask[..., None] > 0.5
        yield in_8_bits(np.where(inside, normal_colors(frame.normals), 1))
    with torch.no_grad():
        whole = with_axes(avatar(frame.pose))
        thin = replace(whole, scales=whole.scales / 3)
        yield in_8_bits(render(thin, frame.camera, background=torch.ones(3)).color.numpy())
    yield from list(turntable(avatar, frame.pose, SIDE_VIEWS + 1, video.size))[1:]


def _new_poses(avatar: Avatar, view: SplitView) -> Iterator[np.ndarray]:
    """Show ground truth and render of two poses, and of the hand that is raised highest in any."""
    frames = {k: view.video.with_true_mask(view.video[k]) for k in view.frames}
    boxes = [(k, person_box(frames[k].mask)) for k in spread(view.frames, 4)[1:3]]
    if view.details is not None:
        found = [(k, box) for k in frames for what, box in view.details.boxes(k) if what == "hands"]
        boxes += sorted(found, key=lambda hand: hand[1].top)[:1]
    for k, box in boxes:
        yield box.cut(cut_out(frames[k]))
        camera = box.cut_camera(frames[k].camera).resized(
            NEW_POSE_SCALE * box.width, NEW_POSE_SCALE * box.height
        )
        yield render_frame(avatar, frames[k].pose, camera)


def _scaled(part: np.ndarray) -> np.ndarray:
    """Crop a picture to its content, and scale it to the height of a row."""
    from PIL import Image

    cut = person_box(part.min(-1) < 250).cut(part)
    width = max(1, round(cut.shape[1] * ROW_HEIGHT / cut.shape[0]))
    resized = Image.fromarray(cut).resize((width, ROW_HEIGHT), Image.Resampling.LANCZOS)
    return np.asarray(resized)


def _stacked(rows: list[np.ndarray]) -> np.ndarray:
    """Stack rows of different widths, each centred."""
    width = max(row.shape[1] for row in rows)
    picture = np.full((len(rows) * ROW_HEIGHT, width, 3), 255, np.uint8)
    for k, row in enumerate(rows):
        left = (width - row.shape[1]) // 2
        picture[k * ROW_HEIGHT : (k + 1) * ROW_HEIGHT, left : left + row.shape[1]] = row
    return picture


ANKLE_STEPS = np.linspace(-0.35, 0.35, 29)  # radians that the hip turns the leg; chosen by eye


def eq8(subject: Path, out: Path) -> None:
    """Draw the frame that Eq. 8 as printed makes worst: overlays, from the side, and its loss."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    body, video = load_body(), load_video(subject)
    truth = load_ground_truth(video.truth, body)
    persons = {"true": (truth.pose, truth.shape), "stage 1": (video.pose, video.shape)}
    for name, options in (("printed", paper.REFINE), ("ours", SequenceOptions())):
        found = refine(video, body, options)
        persons[name] = found.pose, found.shape
    errors = {name: pose_errors(body, person, truth) for name, person in persons.items()}
    k = int((errors["printed"]["feet_aligned"] - errors["stage 1"]["feet_aligned"]).argmax())
    frame, scene = video[k], MeshScene(body.faces, body.v_template)
    figure = Figure(figsize=(11, 5), layout="constrained")
    FigureCanvasAgg(figure)
    above, below = [*persons, "loss"], [*(f"{name}, side" for name in persons), "loss"]
    axes = figure.subplot_mosaic([above, below], width_ratios=[1] * len(persons) + [2.2])
    for name, (pose, shape) in persons.items():
        vertices = body(pose[k], shape).vertices[0].detach()
        shown = overlay(frame.image, frame.camera, vertices, body.faces, scene)
        centre = vertices.mean(0).numpy()
        to_eye = np.linalg.inv(frame.camera.T_camera_world)[:3, 3] - centre
        side = np.cross([0, 1, 0], to_eye)  # as far away, a quarter around: the camera is left
        camera = replace(frame.camera, T_camera_world=look_at(centre + side, centre))
        profile = overlay(np.ones_like(frame.image), camera, vertices, body.faces, scene)
        for axis, image, inside, title in (
            (axes[name], shown, frame.mask, name),
            (axes[f"{name}, side"], profile, profile.min(-1) < 1, "from the side"),
        ):
            axis.imshow(person_box(inside).cut(image).clip(0, 1))
            axis.set_title(title, fontsize=10)
            axis.axis("off")
        axes[name].set_title(f"{name}: feet {errors[name]['feet_aligned'][k]:.0f} mm", fontsize=10)
    _draw_loss(axes["loss"], video, k, body, truth)
    figure.savefig(out, dpi=90)


def _draw_loss(axis, video: Video, k: int, body: BodyModel, truth: GroundTruth) -> None:  # noqa: ANN001
    """Draw the data term of Eq. 8 as the true pose's left leg turns toward the camera."""
    outline = next(video.outlines([k]))
    at = lambda pose, shape=truth.shape: body(pose, shape)
    camera = outline.camera
    forward = torch.from_numpy(camera.T_camera_world[2, :3].copy()).float()
    posed = at(truth.pose[k]).joints[0].detach().float()
    hip, ankle = (JOINTS.index(f"left_{name}") for name in ("hip", "ankle"))
    turn = torch.linalg.cross(posed[ankle] - posed[hip], forward)
    rotations = truth.pose[k].rotations.float().clone()
    axis_at_pelvis = to_matrix(rotations[:, 0])[0].T @ (turn / turn.norm())
    body_at = lambda outline: at(video.pose[outline.index], video.shape).vertices[0].detach()
    scale = common_scale(video, [k], paper.REFINE.size, body_at)
    seen, scene = (
        MaskAndNormals.of(outline, scale, body_at(outline)),
        MeshScene(body.faces, body.v_template),
    )
    depths, losses = [], []
    with torch.no_grad():
        for angle in ANKLE_STEPS:
            moved = rotations.clone()
            step = to_matrix(float(angle) * axis_at_pelvis[None])
            moved[:, hip] = to_rotvec(step @ to_matrix(rotations[:, hip]))
            found = at(Pose(moved, truth.pose[k].transl.float(), truth.pose[k].expression.float()))
            image = scene.render(found.vertices[0].float(), seen.camera)
            losses.append(float(seen.loss(image, paper.REFINE.silhouette)))
            depths.append(1e3 * float((found.joints[0, ankle].float() - posed[ankle]) @ forward))
    best = int(np.argmin(losses))
    axis.plot(depths, losses, "o-", ms=3)
    axis.axvline(0, color="C2", label="the true pose")
    axis.axvline(depths[best], color="C3", ls="--", label=f"least loss: {depths[best]:+.0f} mm")
    axis.set(
        xlabel="depth of the left ankle, mm; the rest is the true pose", ylabel="loss of Eq. 8"
    )
    axis.legend()


if __name__ == "__main__" and sys.argv[1] == "--eq8":
    eq8(Path(sys.argv[2]), Path(sys.argv[3]) / "eq8.png")
elif __name__ == "__main__":
    demo, out = map(Path, sys.argv[1:])
    video = load_video(demo / "subject", demo / "subject" / REFINED_POSES)
    trained = run_folder.under_trained_poses(video, demo / "run")
    out.mkdir(parents=True, exist_ok=True)
    avatar = run_folder.load_avatar(demo / "run")
    Image.fromarray(overview(avatar, trained)).save(out / "overview.png")  # normals: all colours
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        Image.fromarray(scenes(demo, folder)).save(out / "scenes.png")
        app.check(demo / "subject", sheet=folder / "check.png")
        save(read_image(folder / "check.png", 3), out / "check.png")
        save(in_a_row(motions(demo / "run", folder)), out / "motions.png")
        save(in_a_row(exports(demo / "run", folder)), out / "exports.png")
