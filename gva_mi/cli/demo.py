"""The command ``gva-mi demo``: run all steps on a synthetic subject."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path

from gva_mi.body.smplx import load_body
from gva_mi.cli.arguments import Flat, Switch, poses_of
from gva_mi.cli.evaluate import evaluate_run
from gva_mi.cli.fit import fit_video
from gva_mi.core.atomic import folder_lock
from gva_mi.core.console import bar, say
from gva_mi.core.options import PictureSide, Seed
from gva_mi.core.stamp import start_folder
from gva_mi.core.tasks import usual_workers
from gva_mi.data.video import load_video
from gva_mi.fit import run_folder
from gva_mi.fit.options import FitOptions, FromOne
from gva_mi.fit.poses import PoseOptions
from gva_mi.pose.sequence import SequenceOptions
from gva_mi.study.refinement import describe, refine_videos
from gva_mi.synthetic import SynthOptions, make_subject
from gva_mi.synthetic.options import VideoFrames

SUBJECT = "subject"  # where the subject lies within the demo's folder
MARKER = "demo.json"  # every demo's folder holds it


@dataclass(frozen=True)
class DemoOptions:
    """How large the demo is; the defaults take some 3 minutes on 2 cores."""

    seed: Seed = 0  # of the subject, the refinement and the fit
    subject: str = "amira"  # one of the study's seven
    frames: VideoFrames = 64  # of the video
    size: PictureSide = 400  # pixels, width and height
    steps: FromOne = 2000  # steps of the fit
    no_refine: Switch = False  # use stage-1 poses, for comparison


def demo(
    options: Flat[DemoOptions], *, out: Path, body: Path | None = None, overwrite: Switch = False
) -> None:
    """Run all steps on a synthetic subject: synth, refine, fit, evaluate, report.

    Args:
        options: size of the demo.
        out: folder for the subject, the run and the report.
        body: a body in SMPL-X's .npz format; without it the built-in body.
        overwrite: replace a demo that is there.
    """
    start = time.perf_counter()
    model = load_body(body)
    # All options first: a bad one is refused before anything is written or replaced.
    workers = usual_workers()
    synth_options = SynthOptions(
        seed=options.seed,
        subject=options.subject,
        frames=options.frames,
        size=options.size,
        workers=workers,
    )
    trained = PoseOptions(trained=not options.no_refine)
    fit_options = FitOptions(seed=options.seed, steps=options.steps, poses=trained)
    with folder_lock(out, "gva-mi demo"):
        start_folder(out, MARKER, overwrite, {"options": asdict(options)})
        subject = out / SUBJECT
        with bar("synth") as progress:
            make_subject(subject, synth_options, model, progress)
        if not options.no_refine:
            way = SequenceOptions(seed=options.seed)
            with bar("refine") as progress:
                for evaluation in refine_videos(
                    [load_video(subject)], model, way, progress, workers
                ):
                    for line in describe(evaluation):
                        say(line)
        poses = poses_of(subject)
        video = load_video(subject, poses)
        avatar = fit_video(video, model, fit_options, out)
        name = "no_refine" if options.no_refine else "full"
        evaluate_run(out, avatar, video, model, poses, name=name, title="The demo subject")
    minutes = (time.perf_counter() - start) / 60
    say(f"{minutes:.1f} minutes; report: {out / run_folder.REPORT}")
