"""What a person reads: a progress bar with its figures, lines between, numbers of frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol


class Progress(Protocol):
    """What long work calls to say how far it is."""

    def __call__(self, done: int, total: int, **figures: float) -> None:
        """``done`` of ``total`` units are done; ``figures`` are the latest values worth showing."""


_FORM = (
    "{desc:<9}{percentage:3.0f}% {bar:24} {n_fmt}/{total_fmt} [{elapsed} < {remaining}]{postfix}"
)


@contextmanager
def bar(step: str) -> Iterator[Progress]:
    """A progress bar: the step, how far it is, the time left, and its latest figures."""
    from tqdm import tqdm

    with tqdm(desc=step, bar_format=_FORM, dynamic_ncols=True, mininterval=0.5) as shown:

        def progress(done: int, total: int, **figures: float) -> None:
            shown.total = total
            shown.set_postfix({k: _short(v) for k, v in figures.items()}, refresh=False)
            shown.update(done - shown.n)

        yield progress


def say(line: str) -> None:
    """Print a line, above a bar that is being drawn."""
    from tqdm import tqdm

    tqdm.write(line)


def _short(value: float) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:.4g}"


def within(progress: Progress | None, before: int, steps: int, total: int) -> Progress | None:
    """Progress of one piece of work, told as that of the whole.

    Args:
        progress: of the whole; None where nobody watches.
        before: steps of the whole that lie before this piece.
        steps: how many steps of the whole this piece is.
        total: steps of the whole.
    """
    if progress is None:
        return None
    return lambda done, of, **figures: progress(
        before + steps * done // max(1, of), total, **figures
    )


def listed(frames: Sequence[int]) -> str:
    """Ascending frame numbers for people: ``3, 7-9, 12``."""
    runs: list[list[int]] = []
    for k in frames:
        if runs and k == runs[-1][-1] + 1:
            runs[-1].append(k)
        else:
            runs.append([k])
    return ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs)
