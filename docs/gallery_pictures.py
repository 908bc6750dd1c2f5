"""Pictures of the documentation that show the avatar of the demo, and one that shows Eq. 8.

    python docs/gallery_pictures.py DEMO OUT
    python docs/gallery_pictures.py --eq8 SUBJECT OUT
    python docs/gallery_pictures.py --phone ME OUT
    python docs/gallery_pictures.py --ladder SUBJECT RUNS OUT
    python docs/gallery_pictures.py --viewer DEMO OUT

DEMO is the folder of ``gva-mi demo``; ``overview.png``, ``scenes.png``, ``check.png``,
``motions.png`` and ``exports.png`` are written into OUT. SUBJECT is a synthetic subject;
``eq8.png`` is written. ME is the folder of ``gva-mi avatar``; ``phone.webp`` is written. SUBJECT
and RUNS are folders of ``gva-mi study avatar --rows ladder full``, one in ``videos/`` and one in
``runs/``; ``ladder.png`` is written. ``--viewer`` needs Chromium, and writes ``viewer.png``.

The overview shows what an avatar is made of, and what it looks like in new poses. Above: a frame
that training left out, its normals, the Gaussians drawn small, and the avatar from other sides. In
the middle: the ground truth beside the render in poses that are not in the video. Below: face and
hands of frames that training left out, enlarged, beside the avatar.
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
from PIL import Image, ImageDraw, ImageFont

from gva_mi import app
from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import JOINTS, Pose, load_poses, save_poses
from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.body.so3 import to_matrix, to_rotvec
from gva_mi.evaluate.measure import SplitView
from gva_mi.evaluate.pictures import shown_views, turntable
from gva_mi.evaluate.pose_errors import pose_errors
from gva_mi.evaluate.regions import Details, person_box
from gva_mi.fit import paper, run_folder
from gva_mi.fit.renders import CameraPath, cut_out, render_frame
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.mesh.overlay import overlay
from gva_mi.refine import SequenceOptions, refine
from gva_mi.refine.image_evidence import MaskAndNormals, common_scale
from gva_mi.splat import look_at, render
from gva_mi.splat.axes import with_axes
from gva_mi.study.avatar_study import PRINTED_POSES, file_name
from gva_mi.study.variants import FULL, LADDER
from gva_mi.subject.folder import REFINED_POSES
from gva_mi.subject.ground_truth import GroundTruth, load_ground_truth
from gva_mi.subject.normals import normal_colors
from gva_mi.subject.pictures import in_8_bits, read_image
from gva_mi.subject.splits import spread
from gva_mi.subject.video import Video, load_video
from gva_mi.synthetic import SynthOptions, make_subject

# Sizes are chosen by eye, for a page of the site.
ROW_HEIGHT = 400  # pixels of a row of the overview, without its labels
CLOSE_HEIGHT = 200  # the same, of faces and hands, some 50 pixels in the demo's video
LABEL_HEIGHT = 24  # pixels
SIDE_VIEWS = 3  # other sides of the avatar in the overview
NEW_POSE_SCALE = 2  # size of renders in new poses, relative to the video's pictures
VIEW_SIZE = (240, 340)  # width and height in pixels of a view of motions.png and exports.png
VIEWS = 6  # of each of the two
# Scenes of the package in scenes.png, with the frame of the novel poses and the exposure in stops.
SCENES = (("room", 0, 0.7), ("studio", 4, 0), ("sky", 6, 0))
SCENE_RAYS = 256  # per pixel
SCENE_SIDE = 400  # pixels, of each picture
STEPS = (0, 1, 4, 7)  # rows of the ladder that ladder.png shows, before the default
VIEWER_SIZE, SHOWN_SIZE = (1000, 560), (625, 350)  # CSS pixels of the viewer's page; drawn
VIEWER_TURN = 120  # pixels that the mouse is dragged
PHONE_HEIGHT = 320  # pixels of the moving picture
PHONE_MILLISECONDS = 120  # for each frame


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


def motions(run: Path, folder: Path, path: CameraPath, frames: int = VIEWS) -> list[Path]:
    """Render the avatar in the dance of another subject."""
    dancer = folder / "dancer"
    options = SynthOptions(
        motion="dance", frames=frames, size=32, samples=1, bare=True,
        novel_poses=0, novel_views=0,
    )  # fmt: skip
    make_subject(dancer, options, load_body())
    out = folder / "motions"
    app.render(run, out, path, poses=dancer / "truth/poses.npz")
    return sorted(out.glob("*.png"))


def phone(me: Path, folder: Path) -> list[Image.Image]:
    """Return frames: the video, the avatar beside it in the same pose, and in a dance."""
    video = load_video(me / "subject", me / "subject" / REFINED_POSES)
    trained = run_folder.under_trained_poses(video, me / "run")
    avatar = run_folder.load_avatar(me / "run")
    seen = np.any([outline.mask > 0.5 for outline in video.outlines(range(len(video)))], axis=0)
    box = person_box(seen, margin=0.05)
    path = CameraPath("orbit", size=(PHONE_HEIGHT * 2 // 3, PHONE_HEIGHT))
    dance = [read_image(name, 3) for name in motions(me / "run", folder, path, len(video))]
    pictures = []
    for k, new in enumerate(dance):
        camera = box.cut_camera(video.cameras[k])
        filmed = in_8_bits(box.cut(video[k].image))
        parts = [filmed, render_frame(avatar, trained.pose[k], camera), new]
        pictures.append(np.concatenate([_in_height(part, PHONE_HEIGHT) for part in parts], axis=1))
    return [Image.fromarray(picture) for picture in pictures]


def _in_height(part: np.ndarray, height: int) -> np.ndarray:
    size = max(1, round(part.shape[1] * height / part.shape[0])), height
    return np.asarray(Image.fromarray(part).resize(size, Image.Resampling.LANCZOS))


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


Panel = tuple[str, np.ndarray]  # a label, and a picture of 8 bits (H, W, 3)


def overview(avatar: Avatar, video: Video) -> np.ndarray:
    """Return the picture, 8-bit (H, W, 3), on white.

    Args:
        avatar: to show.
        video: of a synthetic subject, opened with the poses that the avatar was trained under.
    """
    view = shown_views(avatar, video, load_body())["novel_pose"]
    rows = (
        (ROW_HEIGHT, _made_of(avatar, video)), (ROW_HEIGHT, _new_poses(avatar, view)),
        (CLOSE_HEIGHT, _close_ups(avatar, video)),
    )  # fmt: skip
    in_rows = [[_labelled(*part, height) for part in row] for height, row in rows]
    return _stacked([np.concatenate(row, axis=1) for row in in_rows])


def _made_of(avatar: Avatar, video: Video) -> Iterator[Panel]:
    frame = video.with_true_mask(video[video.splits.test[0]])
    yield "held-out frame", cut_out(frame)
    inside = frame.mask[..., None] > 0.5
    yield "its normals", in_8_bits(np.where(inside, normal_colors(frame.normals), 1))
    with torch.no_grad():
        whole = with_axes(avatar(frame.pose))
        thin = replace(whole, scales=whole.scales / 3)
        small = render(thin, frame.camera, background=torch.ones(3)).color.numpy()
    yield "Gaussians, drawn small", in_8_bits(small)
    for picture in list(turntable(avatar, frame.pose, SIDE_VIEWS + 1, video.size))[1:]:
        yield "avatar", picture


def _new_poses(avatar: Avatar, view: SplitView) -> Iterator[Panel]:
    """Show ground truth and render of poses that the video does not hold."""
    for k in spread(view.frames, 5)[1:4]:
        frame = view.video.with_true_mask(view.video[k])
        box = person_box(frame.mask)
        yield "new pose: truth", box.cut(cut_out(frame))
        camera = box.cut_camera(frame.camera).resized(
            NEW_POSE_SCALE * box.width, NEW_POSE_SCALE * box.height
        )
        yield "avatar", render_frame(avatar, frame.pose, camera)


def _close_ups(avatar: Avatar, video: Video) -> Iterator[Panel]:
    """Show a face and two hands of frames that training left out."""
    details = Details.of(video, load_body())
    found = [(what, k, box) for k in video.splits.test for what, box in details.boxes(k)]
    faces, hands = ([x for x in found if x[0] == name] for name in ("face", "hands"))
    for what, k, box in (faces[0], hands[0], hands[len(hands) // 2]):
        frame = video.with_true_mask(video[k])
        yield f"{what.removesuffix('s')}: held-out frame", box.cut(cut_out(frame))
        camera = box.cut_camera(frame.camera).resized(CLOSE_HEIGHT, CLOSE_HEIGHT)
        yield "avatar", render_frame(avatar, frame.pose, camera)


def _labelled(label: str, part: np.ndarray, height: int) -> np.ndarray:
    """Crop a picture to its content, scale it to a height, and write above it."""
    cut = person_box(part.min(-1) < 250).cut(part)
    width = max(1, round(cut.shape[1] * height / cut.shape[0]))
    font = ImageFont.load_default(LABEL_HEIGHT * 2 / 3)
    wide = max(width, int(font.getlength(label))) + LABEL_HEIGHT
    panel = Image.new("RGB", (wide, height + LABEL_HEIGHT), "white")
    shown = Image.fromarray(cut).resize((width, height), Image.Resampling.LANCZOS)
    panel.paste(shown, ((wide - width) // 2, LABEL_HEIGHT))
    ImageDraw.Draw(panel).text((wide / 2, 2), label, "black", font, "ma")
    return np.asarray(panel)


def _stacked(rows: list[np.ndarray]) -> np.ndarray:
    """Stack rows of different widths, each centred."""
    width = max(row.shape[1] for row in rows)
    left = [(width - row.shape[1]) // 2 for row in rows]
    sides = [(x, width - row.shape[1] - x) for x, row in zip(left, rows, strict=True)]
    return np.concatenate(
        [
            np.pad(row, ((0, 0), side, (0, 0)), constant_values=255)
            for row, side in zip(rows, sides, strict=True)
        ]
    )


def ladder(subject: Path, runs: Path) -> np.ndarray:
    """Show a new view and a new pose: ground truth, and the avatars of some rows of the ladder."""
    rows: list[list[Panel]] = [[], []]
    for variant in [*(LADDER[k] for k in STEPS), FULL]:
        run = runs / file_name(variant.name)
        poses = PRINTED_POSES if variant.poses == "printed" else REFINED_POSES
        trained = run_folder.under_trained_poses(load_video(subject, subject / poses), run)
        avatar = run_folder.load_avatar(run)
        views = shown_views(avatar, trained, load_body())
        for row, split in zip(rows, ("novel_view", "novel_pose"), strict=True):
            video, k = views[split].video, views[split].frames[1]
            frame = video.with_true_mask(video[k])
            box = person_box(frame.mask, margin=0.1)
            if not row:
                row.append((f"{split.replace('_', ' ')}: truth", box.cut(cut_out(frame))))
            camera = box.cut_camera(frame.camera).resized(
                NEW_POSE_SCALE * box.width, NEW_POSE_SCALE * box.height
            )
            row.append((variant.name, render_frame(avatar, frame.pose, camera)))
    in_rows = [[_labelled(*part, ROW_HEIGHT) for part in row] for row in rows]
    return _stacked([np.concatenate(row, axis=1) for row in in_rows])


def viewer(demo: Path) -> np.ndarray:
    """Show the viewer's page beside the video, turned and posed, as a surface, as a skeleton."""
    from samples.browser import SOFTWARE_WEBGL, Browser
    from samples.viewer_page import ViewerPage

    command = [sys.executable, "-m", "gva_mi", "view", demo / "run", "--port", "0"]
    command += ["--subject", demo / "subject"]
    pages = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            with Browser(*SOFTWARE_WEBGL) as browser:
                page = ViewerPage(browser, process.stdout.readline().split(": ")[0], *VIEWER_SIZE)
                page.close_notice()
                pages.append(page.settled())
                page.click("beside the video")
                page.turn(VIEWER_TURN)
                page.choose("joint", "left_shoulder")
                page.enter("z", "60")
                for mode, frame in (("Gaussians", 0), ("surface", 21), ("skeleton", 42)):
                    page.choose("show", mode)
                    page.enter("frame", str(frame))
                    pages.append(page.settled(pages[-1]))
        finally:
            process.terminate()
    in_size = [
        np.asarray(Image.fromarray(x).resize(SHOWN_SIZE, Image.Resampling.LANCZOS)) for x in pages
    ]
    rows = [np.concatenate(in_size[k : k + 2], axis=1) for k in (0, 2)]
    return np.concatenate(rows)


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
elif __name__ == "__main__" and sys.argv[1] == "--ladder":
    save(ladder(Path(sys.argv[2]), Path(sys.argv[3])), Path(sys.argv[4]) / "ladder.png")
elif __name__ == "__main__" and sys.argv[1] == "--viewer":
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # it drives the browser
    save(viewer(Path(sys.argv[2])), Path(sys.argv[3]) / "viewer.png")
elif __name__ == "__main__" and sys.argv[1] == "--phone":
    with tempfile.TemporaryDirectory() as name:
        first, *others = phone(Path(sys.argv[2]), Path(name))
    first.save(
        Path(sys.argv[3]) / "phone.webp", save_all=True, append_images=others, loop=0,
        duration=PHONE_MILLISECONDS, quality=70, method=6,
    )  # fmt: skip
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
        path = CameraPath("static", size=VIEW_SIZE)
        save(in_a_row(motions(demo / "run", folder, path)), out / "motions.png")
        save(in_a_row(exports(demo / "run", folder)), out / "exports.png")
