"""A folder of steps: what is repeated, what goes on, and what is refused."""

import pytest

from gva_mi.app.pipeline import Step, StepFolder
from gva_mi.core.errors import InputError

MARKER = "about.json"


class Stopped(Exception):
    """In the place of a kill."""


@pytest.fixture
def follow(tmp_path):
    """Run two steps, of which the second reads what the first wrote; return which of them ran."""

    def run(amount=1, factor=2, stop=None, source="video", overwrite=False):
        ran, folder = [], tmp_path / "out"
        first, second = folder / "first", folder / "second"

        def work(name, path, value):
            def write(again):
                ran.append(f"{name} again" if again else name)
                if name == stop:
                    raise Stopped
                path.write_text(str(value()))

            return write

        steps = [
            Step("first", "refine", amount, [], [first], work("first", first, lambda: amount)),
            Step("second", "avatar", factor, [first], [second],
                 work("second", second, lambda: factor * int(first.read_text()))),
        ]  # fmt: skip
        try:
            StepFolder(folder, MARKER, source, overwrite).follow(steps)
        except Stopped:
            return ran
        assert int(second.read_text()) == amount * factor
        return ran

    return run


def test_a_finished_step_is_repeated_only_if_something_it_depends_on_changed(follow, tmp_path):
    assert follow() == ["first", "second"]
    assert follow() == []
    assert follow(factor=3) == ["second"]
    assert follow(amount=5, factor=3) == ["first", "second"]
    (tmp_path / "out/second").unlink()
    assert follow(amount=5, factor=3) == ["second"]
    (tmp_path / "out/first").write_text("5 ")  # another file for the second step
    assert follow(amount=5, factor=3) == ["second"]


def test_a_stopped_step_is_told_that_it_was_begun(follow):
    assert follow(stop="second") == ["first", "second"]
    assert follow(stop="second") == ["second again"]
    assert follow(factor=7, stop="second") == ["second"]
    assert follow(factor=7) == ["second again"]
    assert follow(factor=7) == []


def test_what_is_there_is_not_lost(follow, tmp_path):
    follow(stop="first", source="a mistyped one")  # no step was finished: nothing is there
    follow()
    with pytest.raises(InputError, match="was made from another video; .* --overwrite to repl"):
        follow(source="other")
    assert follow() == []
    assert follow(source="other", overwrite=True) == ["first", "second"]
    (tmp_path / "out" / MARKER).unlink()
    with pytest.raises(InputError, match="has no about.json, so gva-mi did not make it"):
        follow()
    (tmp_path / "out" / MARKER).write_text("[]")
    with pytest.raises(InputError, match="about.json: unexpected format"):
        follow()
