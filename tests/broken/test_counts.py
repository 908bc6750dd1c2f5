"""The numbers that docs/reproducibility.md states are those of the tables that tests go through."""

import importlib.util
import re
from pathlib import Path

TESTS = Path(__file__).parents[1]


def table(path):
    spec = importlib.util.spec_from_file_location(Path(path).stem, TESTS / path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def stated(words):
    """The numbers in a sentence of the page, of which ``words`` holds a # for each."""
    page = " ".join((TESTS.parent / "docs/reproducibility.md").read_text().split())
    page = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", page)  # of a link its words
    found = re.search(re.escape(words).replace(r"\#", r"([\d,]+)"), page)
    assert found, f"the page no longer says: {words}"
    return [int(number.replace(",", "")) for number in found.groups()]


def test_damaged_files():
    fuzz = table("fuzz/test_readers.py")
    readers = len(fuzz.READERS)
    assert len(set(fuzz.READERS)) == readers
    assert stated("good ones of # kinds") == [readers]
    assert stated("`pytest -m slow tests/fuzz` makes # of") == [readers * fuzz.THOROUGH]
    assert stated("The ordinary tests take #.") == [readers * fuzz.QUICK]


def test_what_was_broken_by_hand():
    counts = [
        len(table("broken/subjects.py").SUBJECTS),
        len(table("broken/runs.py").RUNS),
        len(table("broken/motions.py").MOTIONS),
    ]
    assert stated("# subjects, # runs and # motions were broken by hand") == counts
    assert sum(counts) >= 500
