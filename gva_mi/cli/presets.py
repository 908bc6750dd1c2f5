"""Presets: one word on the command line that replaces the defaults of all of a command's options.

Options beside it win: ``gva-mi fit subject --preset paper --no-naked`` changes one thing.
"""

from __future__ import annotations

from collections.abc import Sequence
from inspect import Signature
from typing import Any, Literal

Preset = Literal["default", "paper"]


def with_preset(signature: Signature, verb: str, arguments: Sequence[str]) -> Signature:
    """Return a command's signature with the defaults that ``--preset`` among its arguments sets."""
    words = [word for argument in arguments for word in argument.split("=", 1)]
    given = [after for word, after in zip(words, words[1:], strict=False) if word == "--preset"]
    if "preset" not in signature.parameters or given[-1:] != ["paper"]:
        return signature
    parameters = dict(signature.parameters)
    parameters["options"] = parameters["options"].replace(default=_of_paper(verb))
    return signature.replace(parameters=list(parameters.values()))


def _of_paper(verb: str) -> Any:  # noqa: ANN401
    """Return the options of a verb as the paper prints them."""
    from gva_mi.fit import paper
    from gva_mi.pose.sequence import SequenceOptions

    if verb == "fit":
        return paper.FIT
    return SequenceOptions(silhouette=paper.REFINE.silhouette)
