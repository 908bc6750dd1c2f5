"""The command ``gva-mi synth``: make a synthetic subject."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import Positional

from gva_mi.body.smplx import load_body
from gva_mi.cli.arguments import Flat, Switch, given
from gva_mi.core.atomic import require_writable
from gva_mi.core.console import bar, say
from gva_mi.core.errors import InputError
from gva_mi.core.files import require_replaceable
from gva_mi.data.fingerprint import SYNTH
from gva_mi.synthetic import SynthOptions, degrade, describe_errors, make_subject


def synth(
    out: Positional[Path],
    options: Flat[SynthOptions] = SynthOptions(),  # noqa: B008 (frozen)
    *,
    like: Path | None = None,
    body: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Make a synthetic subject: video, masks, normals, cameras and poses with errors; ground truth.

    Args:
        out: the subject's folder.
        options: options of the subject.
        like: an existing subject, whose recording gets the errors of --error-model, --seed and
            --noise.
        body: a body file in SMPL-X's .npz format; without it the built-in body.
        overwrite: replace an existing subject.
    """
    if like is not None:
        _require_noise_alone(options)
        if out.resolve() == like.resolve():
            raise InputError(f"{out}: is the recording itself; expected another folder than --like")
    model = load_body(body)
    require_replaceable(out, SYNTH, overwrite)
    require_writable(out.absolute().parent)
    replaced = SYNTH if overwrite else None
    with bar("synth") as progress:
        if like is None:
            make_subject(out, options, model, progress, replaced)
        else:
            seed, level = options.seed_of_noise, options.noise
            degrade(like, out, options.error_model, seed, model, level, progress, replaced)
    for line in describe_errors(out):
        say(line)
    say(f"subject: {out}")


def _require_noise_alone(options: SynthOptions) -> None:
    """Raise an InputError if options are given that do not belong to the error model."""
    ours = {name: getattr(options, name) for name in ("error_model", "seed", "noise_seed", "noise")}
    for option in given(options, SynthOptions(**ours)).values():
        raise InputError(
            f"synth: {option} is fixed by the recording of --like; give --error-model, --seed and "
            "--noise alone"
        )
