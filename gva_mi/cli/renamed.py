"""Old names of verbs and options: one sentence tells the new one, or why there is none."""

from __future__ import annotations

from collections.abc import Sequence

from gva_mi.core.errors import InputError

NOW = {
    "gradcheck-normals": "`gva-mi gradcheck normals`",
    "bench normals": "`gva-mi bench mesh`",
    "bench --calls": "--repeats",
    "fit --finest": "--min-scale",
    "fit --poses.nat": "--poses.prior-weight",
    "fit --schedule.look-up-every": "--schedule.rebind-every",
    "refine --nat": "--prior-weight",
    "refine --loss": "--preset paper, which is Eq. 8 as printed",
    "refine --refine-camera": "gone: give `gva-mi prepare --lens`; stage 1 of a film finds it",
    "refine --report": "gone: refinement.png and the run's report.html show the poses",
    "refine --scheduler": "gone: on each machine, run `gva-mi refine` for some of the subjects",
    "track --nat": "--prior-weight",
    "study --edition": "--held-out-set",
    "study --people": "--subjects",
    "study --families": "--error-models",
    "study --told": "--known",
    "study --noise": "gone: errors have their usual size, and synth --noise scales them",
    "synth --sheet": "`gva-mi check --sheet`",
    "synth --family": "--error-model",
    "synth --folds": "gone: cloth always has its usual creases",
    "synth --background": "--scene",
}


def require_current_names(verb: str, arguments: Sequence[str]) -> None:
    """Raise an InputError for the first old name among a command's words."""
    words = [word.split("=")[0].replace("_", "-") for word in arguments]
    for name in (verb, *(f"{verb} {word}" for word in words)):
        if name in NOW:
            raise InputError(f"{name} is now {NOW[name]}")
