"""Docstrings of the project as Markdown, for the site's reference: an extension of griffe.

The docstrings have tables, literal blocks and references of reStructuredText, several arguments in
one line, and comments behind the fields of a record. mkdocs understands none of these.
"""

from __future__ import annotations

import io
import re
import tokenize

from griffe import Attribute, Docstring, Extension, Object

_RULE = re.compile(r"^ *=+( +=+)+ *$")
_ROLE = re.compile(r":\w+:`~?([^`]*)`")
_NAMES = re.compile(r"(\w+(?:,\s+\w+)+):\s+(.*)", re.DOTALL)  # of several arguments
_EXAMPLE = re.compile(r"^Example:$", re.MULTILINE)  # griffe shows programs under Examples
_NO_WORDS = ("noqa", "fmt:", "type:")  # comments that are for tools


def markdown(text: str) -> str:
    """Convert a docstring to Markdown."""
    text = arguments_apart(_EXAMPLE.sub("Examples:", _ROLE.sub(r"`\1`", text)))
    lines, at = [], 0
    source = text.split("\n")
    while at < len(source):
        line = source[at]
        if _RULE.match(line):
            end = _end(source, at)
            lines += ["", *table(source[at:end]), ""]
            at = end
            continue
        if line.strip() == "::":
            line = ""
        elif line.endswith("::"):
            line = line[:-1]
        lines.append(line)
        at += 1
    return "\n".join(lines)


def arguments_apart(text: str) -> str:
    """Split ``a, b: metres`` of ``Args`` into one line for each argument."""
    before, heading, rest = text.partition("\nArgs:\n")
    section, blank, after = rest.partition("\n\n")
    items = []
    for item in re.split(r"\n(?=    \S)", section):
        names = _NAMES.fullmatch(item.strip())
        several = re.split(r",\s+", names[1]) if names else ()
        items += [f"    {name}: {names[2]}" for name in several] or [item]
    return before + heading + "\n".join(items) + blank + after


def _end(lines: list[str], start: int) -> int:
    """Return the line after the table that starts at ``start``."""
    end = start
    for at in range(start, len(lines)):
        if not lines[at].strip():
            break
        if _RULE.match(lines[at]):
            end = at + 1
    return end


def table(lines: list[str]) -> list[str]:
    """Convert a simple table of reStructuredText to Markdown.

    Args:
        lines: from its first rule to its last. A row whose first cell is empty continues the row
            above.
    """
    spans = [match.span() for match in re.finditer("=+", lines[0])]
    starts = [start for start, _ in spans]
    ends = [*starts[1:], None]
    groups: list[list[list[str]]] = [[]]
    for line in lines[1:]:
        if _RULE.match(line):
            groups.append([])
            continue
        cells = [line[a:b].strip().replace("|", "\\|") for a, b in zip(starts, ends, strict=True)]
        if cells[0] or not groups[-1]:
            groups[-1].append(cells)
        else:
            above = groups[-1][-1]
            groups[-1][-1] = [f"{a} {b}".strip() for a, b in zip(above, cells, strict=True)]
    parts = [group for group in groups if group]
    head = parts[0][0] if len(parts) > 1 else [""] * len(starts)
    body = [row for part in parts[1:] for row in part] if len(parts) > 1 else parts[0]
    row = lambda cells: "| " + " | ".join(cells) + " |"
    return [row("" if c == ".." else c for c in head), row(["---"] * len(starts)), *map(row, body)]


def comment_of(source: str) -> str | None:
    """Return the comment behind a field, or None."""
    try:
        tokens = list(tokenize.generate_tokens(io.StringIO(source).readline))
    except (tokenize.TokenError, IndentationError):
        return None
    words = [token.string.lstrip("# ") for token in tokens if token.type == tokenize.COMMENT]
    words = [word for word in words if not word.startswith(_NO_WORDS)]
    return words[-1] if words else None


class ProjectDocstrings(Extension):
    """Convert the docstring of every object that griffe has read."""

    def on_object(self, *, obj: Object, **_: object) -> None:
        """Rewrite a docstring; give a field the comment behind it."""
        if obj.docstring is not None:
            obj.docstring.value = markdown(obj.docstring.value)
        elif isinstance(obj, Attribute) and obj.parent is not None and obj.parent.is_class:
            if comment := comment_of("\n".join(obj.lines)):
                obj.docstring = Docstring(comment, parent=obj)
