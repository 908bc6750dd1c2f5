"""The command ``gva-mi evaluate``: measure an avatar against pictures; write metrics and a page."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import Positional

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.without_body import require_body_of
from gva_mi.body.smplx import BodyModel, body_name, load_body
from gva_mi.cli.arguments import Switch, body_of, poses_of, warn_if_outside_masks
from gva_mi.core.atomic import folder_lock
from gva_mi.core.console import aligned, bar, say
from gva_mi.core.files import require_room
from gva_mi.data.fingerprint import require_same_body
from gva_mi.data.video import Video, load_video
from gva_mi.fit import run_folder
from gva_mi.fit.perceptual import LpipsNetwork, find_weights
from gva_mi.study.evaluate import measure_run
from gva_mi.study.report import write_report
from gva_mi.study.scores import Scorer


def evaluate(
    run: Positional[Path],
    subject: Positional[Path],
    *,
    poses: Path | None = None,
    body: Path | None = None,
    fit_poses: Switch = False,
    lpips: LpipsNetwork | None = None,
) -> None:
    """Measure an avatar on the splits of a subject; write metrics.json and report.html.

    Args:
        run: the folder of a finished fit.
        subject: the folder it was fitted to.
        poses: the poses it was fitted under; without it as the run's record says.
        body: the body that it was fitted with, in SMPL-X's .npz format; without it as the run's
            record says. Hands are measured where it has them.
        fit_poses: also measure test frames, and novel poses of the ground truth, after fitting
            poses to these same frames; reported in separate rows.
        lpips: the network of LPIPS, with your weights: vgg as in the tables of 3DGS and its
            followers, alex as its authors advise; without it alex where it is found, else vgg.
    """
    avatar = Avatar.load(run / run_folder.AVATAR)
    body = body or run_folder.source_of(run, "body", subject) or body_of(subject)
    model = load_body(body)
    require_same_body(subject, model)
    require_body_of(avatar, model, body_name(body))
    poses = poses_of(subject, poses or run_folder.source_of(run, "poses", subject))
    video = load_video(subject, poses)
    video.require_train_frames()
    warn_if_outside_masks(video, model)
    title = subject.resolve().name
    with folder_lock(run, "gva-mi evaluate"):
        require_room(run / run_folder.METRICS, overwrite=True)
        scorer = Scorer(find_weights().of_lpips(lpips))
        about = {"name": "full", "title": title, "fit_poses": fit_poses, "scorer": scorer}
        evaluate_run(run, avatar, video, model, poses, **about)
    say(f"report: {run / run_folder.REPORT}")


def evaluate_run(
    run: Path,
    avatar: Avatar,
    video: Video,
    model: BodyModel,
    poses: Path,
    *,
    name: str,
    title: str,
    fit_poses: bool = False,
    scorer: Scorer | None = None,
) -> None:
    """Measure the avatar of a run, write metrics and report into its folder, print the metrics.

    ``video`` was opened with the ``poses`` (their file) that the fit began with; ``name`` stands in
    the rows.
    """
    trained = run_folder.under_trained_poses(video, run)
    about = {"scorer": scorer, "fit_to_pictures": fit_poses}
    with bar("evaluate") as progress:
        metrics = measure_run(run, avatar, video, name, model, poses, progress, **about)
    write_report(run / run_folder.REPORT, run, avatar, trained, title, model)
    for table in metrics.tables():
        for line in aligned([table.head, *table.rows]):
            say(line)
