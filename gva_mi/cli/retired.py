"""Options that were renamed or removed: the command line answers each with one sentence."""

from __future__ import annotations

from collections.abc import Sequence

from gva_mi.core.errors import InputError

# (verb, old option): the new option, or a sentence that says why there is none.
RENAMED: dict[tuple[str, str], str] = {
    ("bench", "--calls"): "--repeats",
    ("fit", "--finest"): "--min-scale",
    ("fit", "--poses.nat"): "--poses.prior-weight",
    ("fit", "--schedule.look-up-every"): "--schedule.rebind-every",
    ("refine", "--loss"): "is gone: --preset paper is Eq. 8 as printed",
    ("refine", "--nat"): "--prior-weight",
    ("track", "--nat"): "--prior-weight",
    ("study", "--edition"): "--held-out-set",
    ("study", "--people"): "--subjects",
    ("study", "--families"): "--error-models",
    ("study", "--told"): "--known",
    ("study", "--noise"): "is gone: errors have their usual size; synth --noise scales them",
    ("synth", "--sheet"): "is gone: docs/people.md describes the subjects, check --sheet draws one",
    **{
        ("synth", f"--{name}"): "is gone: frames show the person on white"
        for name in ("background", "blur", "sensor-noise")
    },
    **{
        ("gradcheck", f"--{name}"): "is gone: give Python's gradcheck() a scene of your own"
        for name in ("channels", "images")
    },
}

# Constants of the method that Python sets and the command line does not: by dataclass the name it
# has in dotted options, and its fields.
PYTHON_ONLY: dict[str, tuple[str, tuple[str, ...]]] = {
    "SplatOptions": ("splat", (
        "alpha_min", "alpha_max", "transmittance_min", "near", "far", "radius_min", "depth",
    )),
    "SkinningOptions": ("skinning", ("spread", "neighbours", "joints")),
    "SeedOptions": ("seed", ("opacity", "overlap", "flatness")),
    "ResidualOptions": ("residual", ("code", "frequencies", "width")),
    "Rates": ("rates", ("means_end", "quats", "log_scales", "logit_opacities", "light")),
    "DensifyOptions": ("densify", ("split_shrink", "min_opacity", "max_scale")),
    "ReinitOptions": ("reinit", (
        "opaque", "floater_neighbours", "floater_sigmas", "alpha", "filler_depth", "smoothing",
        "curvature_gain", "neighbours", "scale_jitter", "surface", "random",
    )),
    "PoseOptions": ("poses", ("step", "largest_turn", "translation_lr", "decay", "part")),
}  # fmt: skip

# The options of its steps that `gva-mi study avatar` takes: step: dataclass and fields.
OF_STUDY = {"fit": ("FitOptions", ("steps",)), "refine": ("SequenceOptions", ("passes", "size"))}

_REMOVED = {
    f"{name}.{field.replace('_', '-')}": kind
    for kind, (name, fields) in PYTHON_ONLY.items()
    for field in fields
}


def require_current(verb: str, arguments: Sequence[str]) -> None:
    """Raise an InputError for the first option that was renamed or removed."""
    for argument in arguments:
        if not argument.startswith("--"):
            continue
        option = argument.split("=")[0].replace("_", "-")
        now = RENAMED.get((verb, option))
        if now is not None:
            said = f"is called {now} now" if now.startswith("--") else now
            raise InputError(f"{verb}: {option} {said}")
        step, _, field = option.lstrip("-").partition(".")
        if [verb, *arguments[:1]] == ["study", "avatar"] and step in OF_STUDY:
            kind, shown = OF_STUDY[step]
            if field.replace("-", "_") not in shown:
                names = ", ".join(f"--{step}.{name}" for name in shown)
                raise InputError(
                    f"study avatar: has no {option}; it takes {names}, and Python sets all other "
                    f"fields of {kind}"
                )
        kind = _REMOVED.get(".".join(option.lstrip("-").split(".")[-2:]))
        if kind is not None:
            raise InputError(
                f"{verb}: {option} is no option any more and keeps its default; Python sets it, as "
                f"a field of {kind}"
            )
