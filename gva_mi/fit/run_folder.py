"""The folder of a run: files of a fit and of its evaluation, and how a fit resumes.

::

    out/
      options.json         options and versions of the run, hashes of the video, and the files of
                           its poses and body
      checkpoint.pt        the last saved state, until the run is finished
      history.npz          per step: loss and its terms, Gaussians, milliseconds
      reinit/000900.npz    of each re-initialisation: the Gaussians before and after, the mesh
      first/               the run with whose poses this one began, if it has first_steps
      poses.npz            of all frames, if poses were trained; see gva_mi.fit.poses
      avatar.npz           the fitted avatar, written when the run is finished
      metrics.json         of its evaluation: gva_mi.evaluate.measure
      report.html          the evaluation as a page: gva_mi.evaluate.report

Every file is written atomically: after a kill it is the old one or the new one, whole.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from gva_mi.avatar.avatar import AVATAR_FILE, Avatar
from gva_mi.avatar.canonical import CanonicalGaussians
from gva_mi.avatar.export import load_gltf_avatar, load_gltf_motion
from gva_mi.avatar.surface import SurfaceMesh
from gva_mi.avatar.without_body import WITHOUT_BODY, with_body
from gva_mi.body.pose import Pose, Shape, load_poses
from gva_mi.body.smplx import BUILT_IN_NAME, body_name, load_body
from gva_mi.core.atomic import part_of, write_bytes
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import read_arrays, read_bytes, read_json, write_arrays
from gva_mi.core.stamp import RESULTS_VERSIONS, STAMP_BYTES, stamp, write_record
from gva_mi.splat import Gaussians
from gva_mi.subject.folder import CAMERAS
from gva_mi.subject.opened import OpenedSubject, open_subject
from gva_mi.subject.video import Video

AVATAR, CHECKPOINT, HISTORY = "avatar.npz", "checkpoint.pt", "history.npz"
OPTIONS, TRAINED_POSES, REINIT = "options.json", "poses.npz", "reinit"
FIRST_FIT = "first"  # folder, inside a run, of the first fit, whose poses the run starts from
METRICS, REPORT = "metrics.json", "report.html"
GAUSSIANS = ("means", "quats", "scales", "opacities", "sh")


def prepare(
    out: Path,
    options: dict[str, Any],
    video: Video,
    resume: bool,
    sources: Mapping[str, str | None] | None = None,
) -> None:
    """Prepare the folder of a run and write its options, plain values.

    With ``resume``, a run of the same options and video may be there already. ``sources`` are files
    that later commands look for: see :func:`sources_of`.

    Raises:
        InputError: the folder holds a run that is not to be resumed, or one of other options or
            another video.
    """
    held = out / OPTIONS
    if not held.exists():
        if (out / AVATAR).exists() or (out / CHECKPOINT).exists():
            raise InputError(f"{out}: holds a run, but not its {OPTIONS}; choose another folder")
        out.mkdir(parents=True, exist_ok=True)
        about = {"options": options, "video": stamps(video), "sources": dict(sources or {})}
        write_record(held, about)
        return
    if not resume:
        raise InputError(f"{out}: already holds a run; resume it, overwrite it, or choose another")
    before = load_options(out)["options"]
    now = json.loads(json.dumps(options))
    for name in sorted(before.keys() | now.keys()):
        if before.get(name) != now.get(name):
            raise InputError(
                f"{held}: the run was made with {name} = {before.get(name)}, not {now.get(name)}; "
                "resume it with its own options, or choose another folder"
            )
    require_own_video(out, video)


def require_none_begun(out: Path, overwrite: bool) -> None:
    """Raise an InputError if the folder holds an unfinished run that may not be overwritten."""
    if not overwrite and (out / OPTIONS).exists() and not (out / AVATAR).exists():
        raise InputError(
            f"{out}: holds a run that was stopped; give --resume to go on with it, or --overwrite "
            "to replace it"
        )


def stamps(video: Video) -> dict[str, str]:
    """Return a stamp of each part of a video that a fit sees; poses are those it is opened with.

    Poses trained on one video mean nothing in another, even one with as many frames. Files are
    hashed as they are: a re-encoded video is another video, even if the encoding is lossless.
    """
    folder, pose = video.folder, video.pose
    pictures = sorted((folder / "frames").glob("[!.]*.png")) or [folder / "video.mp4"]
    cameras = [x for c in video.cameras for x in (c.K, c.T_camera_world, [c.width, c.height])]
    poses = [pose.rotations, pose.transl, pose.expression, video.shape.betas]
    return {
        "frames": stamp(pictures),
        "masks": stamp([folder / "masks"]),
        "cameras": stamp(cameras),
        "poses": stamp(x.detach() for x in poses),
        "splits": stamp([video.splits.train, video.splits.test]),
    }


def other_parts(run: Path, video: Video) -> list[str]:
    """Return which parts of a video differ from the run's video."""
    known, found = load_options(run)["video"], stamps(video)
    return [part for part in found if found[part] != known.get(part)]


def other_pictures(run: Path, video: Video) -> str:
    """Say whether frames, cameras or both differ from the run's video; "" for neither."""
    return " and ".join(sorted({"frames", "cameras"} & set(other_parts(run, video))))


def require_own_video(run: Path, video: Video) -> None:
    """Raise an InputError unless a video, with its poses, is the one a run was fitted to."""
    others = other_parts(run, video)
    if others:
        raise InputError(
            f"{run}: was fitted to another video than {video.folder}, which has other "
            f"{', '.join(others)}; expected the video and the poses that it was fitted to"
        )


def load_options(out: Path) -> dict[str, Any]:
    """Read a run's ``options``, ``versions``, ``sources``, and the hashes of its ``video``."""
    path = out / OPTIONS
    found = read_json(path, "the options of a run")
    with expecting(path, "the options of a run"):
        rest = {name: dict(found.get(name, {})) for name in ("versions", "video", "sources")}
        return {"options": dict(found["options"]), **rest}


def sources_of(poses: Path, body: Path | None, subject: Path) -> dict[str, str | None]:
    """Return the files of a run's poses and body as ``options.json`` names them.

    Files in the subject's own folder are named from there, so that the folder may be moved.
    """

    def name(path: Path) -> str:
        whole, home = path.resolve(), subject.resolve()
        return str(whole.relative_to(home) if whole.is_relative_to(home) else whole)

    built_in = body is None or str(body) == BUILT_IN_NAME
    return {"poses": name(poses), "body": None if built_in else name(body)}


def source_of(run: Path, what: Literal["poses", "body"], subject: Path) -> Path | None:
    """Return the file of a run's poses or body; None if it was fitted with the usual one.

    Raises:
        InputError: the file does not exist any more.
    """
    path = _recorded(run, what, subject)
    if path is not None and not path.exists() and (subject / CAMERAS).exists():
        raise InputError(
            f"{run}: was fitted with {path}, which does not exist any more; give it with --{what}"
        )
    return path


def open_fitted(
    run: Path, subject: Path, poses: Path | str | None, body: Path | str | None
) -> OpenedSubject:
    """Open a subject with the poses and the body that a run was fitted with, unless given."""
    poses, body = poses or source_of(run, "poses", subject), body or source_of(run, "body", subject)
    return open_subject(subject, poses, body)


def body_of_run(run: Path, given: Path | None) -> Path | None:
    """Return the body file that ``--body`` names, or else the run's, if the file still exists."""
    own = _recorded(run, "body", run)
    return own if given is None and own is not None and own.exists() else given


def _recorded(run: Path, what: Literal["poses", "body"], subject: Path) -> Path | None:
    """Return a file as a run's record names it; None without a record, or for the usual file."""
    known = load_options(run)["sources"] if (run / OPTIONS).exists() else {}
    name = known.get(what)
    return None if name is None else subject / str(name)  # an absolute name stays as it is


def save_state(out: Path, state: dict[str, Any]) -> None:
    """Write the checkpoint: tensors, numbers, strings, and lists and dictionaries of them.

    A stamp follows them, of these bytes, the run's options and the results version, so that a state
    that was changed by hand, or belongs to another run or program, is refused when it is opened,
    and not somewhere in training.
    """
    whole = io.BytesIO()  # torch's own writer hides a full disk
    torch.save(state, whole)
    content = whole.getbuffer()
    write_bytes(out / CHECKPOINT, content, _stamp_of_state(out, content))


def load_state(out: Path) -> dict[str, Any] | None:
    """Read the checkpoint; None without one; an InputError unless it is as it was saved."""
    path = out / CHECKPOINT
    if not path.exists():
        return None
    whole = memoryview(read_bytes(path, "the checkpoint of a run"))
    content, stamped = whole[:-STAMP_BYTES], whole[-STAMP_BYTES:]
    if stamped != _stamp_of_state(out, content):
        raise InputError(
            f"{path}: not as this run saved it: cut short, changed, or of another run or version; "
            "--overwrite starts the fit again"
        )
    return torch.load(io.BytesIO(content), weights_only=True)


def drop_state(out: Path) -> None:
    """Remove the checkpoint of a finished run, also one that a kill left half-written."""
    for path in (out / CHECKPOINT, part_of(out / CHECKPOINT)):
        path.unlink(missing_ok=True)


def _stamp_of_state(out: Path, content: memoryview) -> bytes:
    return stamp([out / OPTIONS, content], version=RESULTS_VERSIONS["avatar"]).encode()


def save_snapshot(
    out: Path,
    step: int,
    before: CanonicalGaussians,
    after: CanonicalGaussians,
    surface: SurfaceMesh,
) -> None:
    """Write the Gaussians on both sides of a re-initialisation, and the surface between them."""
    arrays = {"vertices": surface.vertices, "faces": surface.faces}
    for side, gaussians in (("before", before), ("after", after)):
        for name in GAUSSIANS:
            arrays[f"{side}_{name}"] = getattr(gaussians, name).detach().numpy()
    write_arrays(out / REINIT / f"{step:06d}.npz", **arrays)


@dataclass(frozen=True)
class Snapshot:
    """The Gaussians on both sides of a re-initialisation, in the rest pose."""

    step: int
    before: Gaussians
    after: Gaussians
    surface: SurfaceMesh  # between them


def load_snapshots(out: Path) -> Iterator[Snapshot]:
    """Yield the Gaussians around each re-initialisation of a run, by step."""
    for path in sorted((out / REINIT).glob("[!.]*.npz")):
        expected = "the Gaussians around a re-initialisation"
        arrays = read_arrays(path, expected)
        with expecting(path, expected):
            before, after = (
                Gaussians(**{n: torch.from_numpy(arrays[f"{side}_{n}"]) for n in GAUSSIANS})
                for side in ("before", "after")
            )
            surface = SurfaceMesh(arrays["vertices"], arrays["faces"])
            step = int(path.stem)
        yield Snapshot(step, before, after, surface)


def last_surface(run: Path) -> SurfaceMesh | None:
    """Read the surface of a run's last re-initialisation; None if it has none, or is a file."""
    found = sorted((run / REINIT).glob("[!.]*.npz"))
    if not found:
        return None
    expected = "the surface of a re-initialisation"
    arrays = read_arrays(found[-1], expected)
    with expecting(found[-1], expected):
        return SurfaceMesh(arrays["vertices"].astype(float), arrays["faces"].astype(np.int64))


def load_history(out: Path) -> dict[str, np.ndarray]:
    """Read the history of a run: columns (steps,) by name."""
    return read_arrays(out / HISTORY, "the history of a finished fit")


def steps_and_seconds(out: Path) -> tuple[int, float]:
    """Return how many steps a finished run took, and how long they took, with its first fit."""
    fits = [out, *([out / FIRST_FIT] if (out / FIRST_FIT).exists() else [])]
    found = [load_history(fit)["milliseconds"] for fit in fits]
    return sum(map(len, found)), float(sum(x.sum() for x in found) / 1e3)


def load_avatar(run: Path, body: Path | None = None) -> Avatar:
    """Load the avatar of a finished run, given its folder, or of a file.

    ``body`` is the body file of an avatar without its body; None: the built-in body.

    Raises:
        InputError: no such file, not an avatar, or another body.
    """
    path = run / AVATAR if run.is_dir() else run
    if path.suffix.lower() == ".glb":
        return load_gltf_avatar(path)
    arrays = read_arrays(path, AVATAR_FILE)
    if str(arrays.get("format")) != WITHOUT_BODY:
        return Avatar.from_arrays(path, arrays)
    return with_body(path, arrays, load_body(body), body_name(body))


def load_motion(run: Path, poses: Path | None) -> tuple[Pose, Shape, Path]:
    """Load a motion, the shape of its person, and the name of its file.

    ``poses`` is a file; None: the poses trained with the avatar of the ``run``, its folder or its
    file in there, or the first motion of a .glb.
    """
    if poses is None and run.suffix.lower() == ".glb":
        return *load_gltf_motion(run), run
    folder = run if run.is_dir() else run.parent
    path = poses or trained_poses(folder)
    if path is None:
        raise InputError(f"{folder}: holds no {TRAINED_POSES} that were trained; give --poses")
    return *load_poses(path), path


def trained_poses(run: Path) -> Path | None:
    """Return the file of the poses that were trained with a run's avatar; None if none were.

    Raises:
        InputError: the run trained poses, and their file does not exist any more.
    """
    path = run / TRAINED_POSES
    if path.exists():
        return path
    made_with = load_options(run)["options"] if (run / OPTIONS).exists() else {}
    if made_with.get("poses", {}).get("trained"):
        raise InputError(f"{path}: no such file; restore the run's trained poses, or fit again")
    return None


def under_trained_poses(video: Video, run: Path) -> Video:
    """Return the video under the poses that were trained with the avatar, if any were.

    Raises:
        InputError: the run was fitted to another video, or its poses are missing, or of another
            number of frames or another person.
    """
    require_own_video(run, video)
    path = trained_poses(run)
    if path is None:
        return video
    pose, shape = load_poses(path, len(video))
    if not torch.equal(shape.betas, video.shape.betas):
        raise InputError(f"{path}: its betas are of another person than those of {video.folder}")
    return replace(video, pose=pose)
