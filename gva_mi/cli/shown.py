"""Which fields of the option dataclasses the command line shows; Python sets the others."""

from __future__ import annotations

from collections.abc import Sequence

PYTHON_ONLY: dict[str, tuple[str, ...]] = {  # constants of the method, by dataclass
    "SplatOptions": (
        "alpha_min", "alpha_max", "transmittance_min", "near", "far", "radius_min", "depth",
    ),
    "SkinningOptions": ("spread", "neighbours", "joints"),
    "SeedOptions": ("opacity", "overlap", "flatness"),
    "ResidualOptions": ("code", "frequencies", "width"),
    "Rates": ("means_end", "quats", "log_scales", "logit_opacities", "light"),
    "ReinitOptions": (
        "floater_sigmas", "alpha", "filler_depth", "smoothing", "scale_jitter", "surface", "random",
    ),
    "PoseOptions": ("step", "largest_turn", "translation_lr", "part"),
}  # fmt: skip

# The options of its steps that `gva-mi study avatar` takes.
OF_STUDY = {"FitOptions": ("steps",), "SequenceOptions": ("passes", "size")}


def is_shown(kind: str, field: str, words: Sequence[str]) -> bool:
    """Return whether a field of a dataclass is an option of a command, given by its first words."""
    if list(words[:2]) == ["study", "avatar"] and kind in OF_STUDY:
        return field in OF_STUDY[kind]
    return field not in PYTHON_ONLY.get(kind, ())
