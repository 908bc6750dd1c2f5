"""The command line: one subcommand per step, generated from the steps' signatures and options."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from gva_mi import llvm
from gva_mi.errors import InputError


def main(arguments: list[str] | None = None) -> None:
    """Run ``gva-mi``; bad input ends with one sentence and exit code 2."""
    arguments = sys.argv[1:] if arguments is None else arguments
    # torch's idle threads would spin on the cores that Dr.Jit's kernels need; read at its import.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    if arguments[:1] == ["doctor"]:
        doctor()
        return
    try:
        llvm.require()
        _run(arguments)
    except (InputError, ImportError) as error:
        print(f"gva-mi: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("\ngva-mi: stopped; --resume goes on with a fit", file=sys.stderr)
        sys.exit(130)


def doctor() -> None:
    """Say what this machine has, and what is missing for what."""
    from gva_mi.commands.doctor import examine

    findings = []
    for finding in examine():
        findings.append(finding)
        print(finding, flush=True)
    sys.exit(0 if all(finding.fine for finding in findings) else 1)


def _run(arguments: list[str]) -> None:
    import tyro

    from gva_mi.commands import checks, pipeline
    from gva_mi.commands import study as studies
    from gva_mi.commands import track as tracking
    from gva_mi.commands.body import body

    steps = {
        "demo": pipeline.demo,
        "synth": pipeline.synth,
        "refine": pipeline.refine,
        "fit": pipeline.fit,
        "evaluate": pipeline.evaluate,
        "track": tracking.track,
        "render": pipeline.render,
        "study": studies.study,
        "body": body,
        "gradcheck": checks.gradcheck,
        "gradcheck-normals": checks.gradcheck_normals,
        "bench": checks.bench,
        "doctor": doctor,
    }
    with _one_sentence():
        written = tyro.extras.subcommand_cli_from_dict(
            steps,
            prog="gva-mi",
            description="A monocular video of a person becomes a drivable 3D Gaussian avatar.",
            args=arguments,
            config=(tyro.conf.FlagCreatePairsOff,),
        )
    for path in written or []:
        print(path)


@contextmanager
def _one_sentence() -> Iterator[None]:
    """Values that options refuse end as all bad input does, and not in tyro's frame.

    tyro frames what a number cannot be read from, and what options within options raise, such as
    ``--splat.blur -1``.
    """
    try:
        from tyro._errors import InstantiationFailure, ParseErrorEvent, on_parse_error
    except ImportError:  # not public: without it there is a frame around the sentence
        yield
        return

    def tell(event: ParseErrorEvent) -> None:
        if not isinstance(event, InstantiationFailure):
            return
        if event.argument is None:
            raise InputError(event.message)
        wanted = event.argument.lowered
        name = "/".join(wanted.name_or_flags)
        raise InputError(f"{name} must be {wanted.metavar}: {event.message}")

    with on_parse_error(tell):
        yield


if __name__ == "__main__":
    main()
