"""What README and the pages of docs/ tell a reader to type."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCKS = re.compile(r"```(\w*)\n(.*?)```", re.DOTALL)
LINE = re.compile(r"^gva-mi .*?(?=\s*(?:#[ ].*)?$)", re.MULTILINE)
OF_SHELLS = re.compile(r"^(?:\S*python|pip|pytest|make|apt-get) .*$")


def blocks(page):
    """Programs for a shell, whole."""
    return [block for kind, block in BLOCKS.findall(page.read_text()) if kind == "sh"]


def backquoted(page):
    """What stands in backquotes outside of programs."""
    return re.findall(r"`([^`\n]+)`", BLOCKS.sub("", page.read_text()))


def commands(page):
    """The commands of a page: lines of its programs for a shell, and what stands in backquotes."""
    for block in blocks(page):
        yield from LINE.findall(block)
    for written in backquoted(page):
        if written.startswith("gva-mi "):
            # Options that may be left out are read, too.
            yield re.sub(r"\[(--\w.*?)\]", r"\1", written)


def typed(page):
    """Those that a reader types: in backquotes a verb alone, or what other lines begin with, is
    a name."""
    lines = [line for block in blocks(page) for line in LINE.findall(block)]
    every = list(commands(page))
    for command in every:
        begun = any(other.startswith(f"{command} ") for other in every)
        if command in lines or (len(command.split()) > 2 and not begun):
            yield command


def other_commands(page):
    """What a reader types that is not ``gva-mi``, without what is said about it."""
    for block in blocks(page):
        lines = (line.split(" #")[0].strip() for line in block.splitlines())
        yield from (line for line in lines if line and not line.startswith("gva-mi "))
    yield from (written for written in backquoted(page) if OF_SHELLS.match(written))
