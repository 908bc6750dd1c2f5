"""Every number that a command takes has a range, and what lies outside ends in one sentence."""

import dataclasses
import re
from typing import Annotated, ClassVar, get_args, get_origin, get_type_hints

import pytest

from gva_mi.commands import VERBS, load
from gva_mi.errors import InputError
from gva_mi.fit.options import FitOptions, Rates
from gva_mi.parse import parse
from gva_mi.pose.sequence import SequenceOptions
from gva_mi.ranges import Within, ranges, require_ranges
from gva_mi.splat import SplatOptions

REQUIRED = {  # what each command would miss before it looked at a number
    "bench": "splat", "demo": "--out new", "export": "run --out a.ply", "fit": "subject --out new",
    "motion": "a.npz b.npz", "prepare": "auto source new --body puppet", "refine": "subject",
    "render": "run --out new", "track": "run subject", "view": "run",
    "study": "refine --out new",
}  # fmt: skip
OUTSIDE = ("nan", "inf", "-inf", "1e30", "-1e30", "1" + 20 * "0")  # of every range


def numbers(hint, name=""):
    """Names and annotations of all numbers in a signature, as in ``--loss.alpha``."""
    hints = get_type_hints(hint, include_extras=True) if callable(hint) else {}
    for field, kind in hints.items():
        yield from number(kind, f"{name}{field}")


def number(kind, name):
    if get_origin(kind) is ClassVar:
        return
    if kind in (int, float) or get_origin(kind) is Annotated and get_args(kind)[0] in (int, float):
        yield name, kind
    elif dataclasses.is_dataclass(kind):
        yield from numbers(kind, f"{name}.")
    else:
        for part in get_args(kind):
            yield from number(part, name)


NUMBERS = [(verb, *found) for verb in VERBS for found in numbers(load(verb))]


def test_numbers_are_found_wherever_they_are():
    found = {(verb, name) for verb, name, _ in NUMBERS}
    assert {("fit", "options.loss.alpha"), ("refine", "workers"), ("view", "port")} <= found
    assert ("study", "what.options.fit.poses.learn_at") in found and len(NUMBERS) > 150


@pytest.mark.parametrize("verb", VERBS)
def test_every_number_states_its_range(verb):
    without = [name for v, name, kind in NUMBERS if v == verb and not list(ranges(kind))]
    assert not without


SEVERAL = {  # numbers that an option takes
    ("render", "size"): 2, ("export", "size"): 2, ("prepare", "normals-size"): 2,
    ("prepare", "normals-mean"): 3, ("prepare", "normals-std"): 3,
}  # fmt: skip


def told_by_help(verb, words, capsys):
    """The options of whose form --help says that it is a number."""
    with pytest.raises(SystemExit):
        parse(load(verb), f"gva-mi {verb}", [*words, "--help"])
    return re.findall(
        r"(--[\w.-]+) [^\s\w]*(?:None[^\s\w]*)?(?:INT|FLOAT) ", capsys.readouterr().out
    )


@pytest.mark.parametrize("verb", sorted({verb for verb, _, _ in NUMBERS}))
def test_what_lies_outside_is_one_sentence_that_names_the_option(verb, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    words = REQUIRED.get(verb, "").split()
    told = told_by_help(verb, words, capsys)
    if verb != "study":  # of which only one half is asked here
        names = {name.split(".")[-1].replace("_", "-") for v, name, _ in NUMBERS if v == verb}
        assert {option.strip("-").split(".")[-1] for option in told} == names
    for turn, option in enumerate(told):
        bad = OUTSIDE[turn % len(OUTSIDE)]
        with pytest.raises(InputError) as error:
            several = [bad] * SEVERAL.get((verb, option.split(".")[-1].lstrip("-")), 1)
            parse(load(verb), f"gva-mi {verb}", [*words, option, *several])
        sentence = str(error.value)
        assert sentence.startswith(f"{option} must be a") and sentence.endswith(f", got {bad}")
        assert "\n" not in sentence


def test_ranges_hold_for_those_who_make_options_in_python():
    for bad in (float("nan"), float("inf"), 1e30, 10**20, -1):
        for make in (
            lambda bad: FitOptions(steps=bad),
            lambda bad: Rates(means=bad),
            lambda bad: SequenceOptions(nat=bad),
            lambda bad: SequenceOptions(height=bad),
            lambda bad: SplatOptions(far=bad),
        ):
            with pytest.raises(InputError, match=r"^\w+: \w+ must be (from|above) .*, got "):
                make(bad)
    with pytest.raises(InputError, match=r"fit: steps must be a whole number, got 2\.5"):
        FitOptions(steps=2.5)


def test_ends_belong_to_a_range_unless_it_is_open():
    assert 0 in Within(0, 1) and 1.0 in Within(0, 1) and float("nan") not in Within(0, 1)
    assert 0 not in Within(0, 1, "low") and 1 in Within(0, 1, "low")
    assert not {0, 1} & {x for x in (0, 1, 0.5) if x in Within(0, 1, "low high")}
    assert True not in Within(0, 1) and "1" not in Within(0, 1)
    told = [str(Within(0, 1e6)), str(Within(0, 2, "low")), str(Within(1, 9, "low high", "px"))]
    assert told == ["from 0 to 1,000,000", "above 0 and at most 2", "above 1 and below 9 px"]


def test_each_of_several_numbers_is_looked_at():
    @dataclasses.dataclass
    class Options:
        shares: tuple[Annotated[float, Within(0, 1)], ...] = ()
        height: Annotated[float, Within(0, 3)] | None = None

    require_ranges("fit", Options((0.5, 1.0)))
    with pytest.raises(InputError, match="fit: shares must be from 0 to 1, got 2"):
        require_ranges("fit", Options((0.5, 2)))
    with pytest.raises(InputError, match="fit: height must be from 0 to 3, got 4"):
        require_ranges("fit", Options(height=4))
