"""Presets: one word on the command line that replaces the defaults of all of a command's options.

Options beside it win: ``gva-mi fit subject --preset paper --no-naked`` changes one thing.
"""

from __future__ import annotations

from collections.abc import Sequence
from inspect import Signature
from typing import Any, Literal

Preset = Literal["default", "paper"]
FitPreset = Literal["default", "paper", "film"]


def with_preset(signature: Signature, verb: str, arguments: Sequence[str]) -> Signature:
    """Return a command's signature with the defaults that ``--preset`` among its arguments sets."""
    words = [word for argument in arguments for word in argument.split("=", 1)]
    given = [after for word, after in zip(words, words[1:], strict=False) if word == "--preset"]
    known = _presets(verb) if given and "preset" in signature.parameters else {}
    if not given or given[-1] not in known:
        return signature
    parameters = dict(signature.parameters)
    parameters["options"] = parameters["options"].replace(default=known[given[-1]])
    return signature.replace(parameters=list(parameters.values()))


def _presets(verb: str) -> dict[str, Any]:
    """Return the options of a verb's presets: as the paper prints them, and for a film."""
    from gva_mi.fit import paper
    from gva_mi.fit.options import FitOptions
    from gva_mi.pose.sequence import SequenceOptions

    if verb == "fit":
        return {"paper": paper.FIT, "film": FitOptions(steps=2000).of_film()}
    return {"paper": SequenceOptions(silhouette=paper.REFINE.silhouette)}
