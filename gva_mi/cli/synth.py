"""The command ``gva-mi synth``: make a synthetic subject."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from tyro.conf import Positional

from gva_mi.body.smplx import load_body
from gva_mi.cli.arguments import Flat, Switch
from gva_mi.core.atomic import require_writable
from gva_mi.core.console import bar, say
from gva_mi.core.files import require_replaceable
from gva_mi.core.tasks import usual_workers
from gva_mi.data.fingerprint import SYNTH
from gva_mi.synthetic import SynthOptions, make_subject


def synth(
    out: Positional[Path],
    options: Flat[SynthOptions] = SynthOptions(),  # noqa: B008 (frozen)
    *,
    body: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Make a synthetic subject: video, masks, normals, cameras and poses with errors; ground truth.

    Args:
        out: the subject's folder.
        options: options of the subject.
        body: a body file in SMPL-X's .npz format; without it the built-in body.
        overwrite: replace an existing subject.
    """
    model, options = load_body(body), replace(options, workers=usual_workers())
    require_replaceable(out, SYNTH, overwrite)
    require_writable(out.absolute().parent)
    with bar("synth") as progress:
        make_subject(out, options, model, progress, SYNTH if overwrite else None)
    say(f"subject: {out}")
