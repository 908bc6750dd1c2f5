"""The command line: one subcommand per step, generated from the steps' signatures and options."""

from __future__ import annotations

import os
import sys

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
    from gva_mi.doctor import examine

    findings = []
    for finding in examine():
        findings.append(finding)
        print(finding, flush=True)
    sys.exit(0 if all(finding.fine for finding in findings) else 1)


def _run(arguments: list[str]) -> None:
    import tyro

    from gva_mi import checks, pipeline
    from gva_mi.data.synthetic.show_body import body

    steps = {
        "demo": pipeline.demo,
        "synth": pipeline.synth,
        "refine": pipeline.refine,
        "fit": pipeline.fit,
        "evaluate": pipeline.evaluate,
        "render": pipeline.render,
        "body": body,
        "gradcheck": checks.gradcheck,
        "bench": checks.bench,
        "doctor": doctor,
    }
    written = tyro.extras.subcommand_cli_from_dict(
        steps,
        prog="gva-mi",
        description="A monocular video of a person becomes a drivable 3D Gaussian avatar.",
        args=arguments,
        config=(tyro.conf.FlagCreatePairsOff,),
    )
    for path in written or []:
        print(path)


if __name__ == "__main__":
    main()
