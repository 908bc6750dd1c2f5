"""The commands of README and of the pages in docs/."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCKS = re.compile(r"```(\w*)\n(.*?)```", re.DOTALL)
LINE = re.compile(r"^gva-mi .*?(?=\s*(?:#[ ].*)?$)", re.MULTILINE)


def blocks(page):
    """Return the shell blocks of a page."""
    return [block for kind, block in BLOCKS.findall(page.read_text()) if kind == "sh"]


def backquoted(page):
    """Return the words in backquotes outside of blocks."""
    return re.findall(r"`([^`\n]+)`", BLOCKS.sub("", page.read_text()))


def commands(page):
    """Yield the commands of a page: lines of its shell blocks, and words in backquotes."""
    for block in blocks(page):
        yield from LINE.findall(block)
    for written in backquoted(page):
        if written.startswith("gva-mi "):
            # Optional options are read, too.
            yield re.sub(r"\[(--\w.*?)\]", r"\1", written)


def typed(page):
    """Yield the commands that a reader types, without verbs alone or beginnings of other ones."""
    lines = [line for block in blocks(page) for line in LINE.findall(block)]
    every = list(commands(page))
    for command in every:
        begun = any(other.startswith(f"{command} ") for other in every)
        if command in lines or (len(command.split()) > 2 and not begun):
            yield command
