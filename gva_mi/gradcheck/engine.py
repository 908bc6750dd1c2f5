"""The engine of every gradient check: comparisons by all methods, a verdict, a table, JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from gva_mi.core.console import aligned
from gva_mi.core.files import write_json
from gva_mi.gradcheck.probes import IMAGES, Probe, Tensors, gradients, leaves, tangents

Draw = Callable[[Tensors], Sequence[Tensor]]  # from the inputs to the images
PRECISIONS = {"f32": torch.float32, "f64": torch.float64}
# Relative L2 error from which a failing float32 comparison is wrong; below, it has lost digits.
# Chosen: a hundred times the tolerance of float32; a formula that is wrong by 0.1 % is beyond it.
WRONG_ERROR = 1e-3


@dataclass(frozen=True)
class Comparison:
    """Comparison of one result with its reference.

    Example:
        >>> found, truth = torch.tensor([1.0, 2.0]), torch.tensor([1.0, 2.1])
        >>> row = Comparison.of("adjoint f32", "means", found, truth, tolerance=1e-5)
        >>> round(row.error, 3), row.where, row.passed
        (0.043, (1,), False)
    """

    method: str  # how the result was computed, such as "adjoint f32"
    name: str  # the input whose gradient is compared, or the image
    error: float  # relative L2
    worst: float  # greatest absolute error of an entry
    where: tuple[int, ...]  # its index; () for a derivative along a direction of all entries
    tolerance: float  # of the error

    @staticmethod
    def of(method: str, name: str, found: Tensor, truth: Tensor, tolerance: float) -> Comparison:
        """Compare two tensors of one shape."""
        off = found - truth
        norm = float(truth.norm())
        error = float(off.norm()) / norm if norm else float(off.norm())
        if not off.numel():
            return Comparison(method, name, error, 0.0, (), tolerance)
        where = torch.unravel_index(off.abs().argmax(), off.shape)
        index = tuple(int(i) for i in where)
        return Comparison(method, name, error, float(off.abs()[where]), index, tolerance)

    @property
    def passed(self) -> bool:
        """Whether the error is within the tolerance; a NaN is not."""
        return self.error <= self.tolerance

    @property
    def coarse(self) -> bool:
        """Whether float32 lost digits here without any other error."""
        return not self.passed and self.method.endswith("f32") and self.error < WRONG_ERROR


@dataclass(frozen=True)
class Check:
    """A loss L = <w, images> of named inputs, with its true images and gradients.

    Example:
        An image x² of two pixels, and a function in its place whose gradient lacks the factor 2.

        >>> inputs = leaves({"x": torch.tensor([[1.0, 3.0]])})
        >>> images, weights = {"color": inputs["x"] ** 2}, {"color": torch.ones(1, 2).double()}
        >>> probe = lambda gradient: Probe.among(gradient, 1, torch.Generator().manual_seed(0))
        >>> check = Check.of(inputs, images, weights, torch.zeros(1, 2, dtype=torch.bool), probe)
        >>> wrong = lambda values: [values["x"] * values["x"].detach()]
        >>> rows = check.methods(wrong, "f64", image=1e-10, adjoint=1e-10, tangent=1e-10)
        >>> [(row.method, row.name, row.error) for row in rows]
        [('adjoint f64', 'color', 0.0), ('adjoint f64', 'x', 0.5), ('tangent f64', 'x', 0.5)]
    """

    values: Tensors  # the inputs, float64, of numbers that float32 holds
    images: Tensors  # the true images (H, W, ...), by name
    weights: Tensors  # w of each image; 0 in the band
    truth: Tensors  # the true gradients with respect to the inputs
    probes: dict[str, Probe]  # directions of each input
    band: Tensor  # (H, W) bool, pixels at a step of the picture, which are left out

    @staticmethod
    def of(
        leaves: Tensors,
        images: Tensors,
        weights: Tensors,
        band: Tensor,
        probe: Callable[[Tensor], Probe],
    ) -> Check:
        """Compute the inputs' true gradients, and choose directions by each of them."""
        truth = gradients(images.values(), leaves, weights.values())
        probes = {name: probe(gradient) for name, gradient in truth.items()}
        detached = lambda tensors: {name: x.detach() for name, x in tensors.items()}
        return Check(detached(leaves), detached(images), weights, truth, probes, band)

    def methods(
        self, draw: Draw, label: str, image: float, adjoint: float, tangent: float
    ) -> Iterator[Comparison]:
        """Compare images, adjoints and tangents of a function in one precision.

        Args:
            draw: the function.
            label: of PRECISIONS.
            image, adjoint, tangent: the greatest errors allowed.
        """
        method, dtype = f"adjoint {label}", PRECISIONS[label]
        inputs = leaves(self.values, dtype)
        images = draw(inputs)
        for (name, true), found in zip(self.images.items(), images, strict=True):
            inside = ~self.band.view(*self.band.shape, *[1] * (true.ndim - 2))
            shown = found.detach().double() * inside, true * inside
            yield Comparison.of(method, name, *shown, image)
        found = gradients(images, inputs, [w.to(dtype) for w in self.weights.values()])
        for name, gradient in found.items():
            true = self.truth[name]
            yield Comparison.of(method, name, gradient.double(), true, adjoint)
        yield from self.tangents(draw, label, tangent)

    def tangents(self, draw: Draw, label: str, allowed: float) -> Iterator[Comparison]:
        """Compare the tangents of a function along every input in one precision."""
        inputs = leaves(self.values, PRECISIONS[label])
        for name in inputs:
            moves = partial(tangents, draw, inputs, name)
            yield self.along(f"tangent {label}", name, moves, allowed)

    def along(
        self, method: str, name: str, moves: Callable[[Tensor], Sequence[Tensor]], allowed: float
    ) -> Comparison:
        """Compare <w, J v> with <J^T w, v> for every direction v of an input.

        Args:
            method, name: of the comparison, and of the input.
            moves: from a direction v to J v, image by image.
            allowed: the greatest error.
        """
        probe = self.probes[name]
        pairs = lambda v: zip(self.weights.values(), moves(v), strict=True)
        derivatives = [
            sum(float((w * d.double()).sum()) for w, d in pairs(v)) for v in probe.directions()
        ]
        values = torch.tensor(derivatives, dtype=torch.float64)
        row = Comparison.of(method, name, values, probe.along(self.truth[name]), allowed)
        return replace(row, where=((), *probe.entries)[row.where[0]])


@dataclass(frozen=True)
class Report:
    """All comparisons of one scene.

    Example:
        >>> right = Comparison("adjoint f32", "means", 2e-6, 1e-4, (4, 1), tolerance=1e-5)
        >>> wrong = Comparison("adjoint f32", "quats", 3e-2, 5e-2, (0, 2), tolerance=1e-5)
        >>> print(Report((right, wrong), "8 Gaussians, 256 pixels").table())
        method       of     error    allowed  worst    at
        adjoint f32  means  2.0e-06  1.0e-05  1.0e-04  [4, 1]
        adjoint f32  quats  3.0e-02  1.0e-05  5.0e-02  [0, 2]  <- FAILS
        WRONG: adjoint f32 of quats (8 Gaussians, 256 pixels)
    """

    rows: tuple[Comparison, ...]
    subject: str  # what was looked at, for the verdict: "40 Gaussians, 1024 pixels"
    notes: tuple[str, ...] = ()  # comparisons that could not be made

    @property
    def passed(self) -> bool:
        """Whether every comparison passes."""
        return all(row.passed for row in self.rows)

    @property
    def verdict(self) -> str:
        """The result in one sentence; a different image comes before its gradients."""
        failed = [row for row in self.rows if not row.passed]
        if not failed:
            return f"all {len(self.rows)} comparisons pass ({self.subject})"
        wrong = [row for row in failed if not row.coarse]
        methods: dict[str, dict[str, None]] = {}  # of each input, each once
        for row in wrong or failed:
            methods.setdefault(row.name, {})[row.method] = None
        inputs: dict[str, list[str]] = {}  # by methods that fail together
        for name, by in methods.items():
            inputs.setdefault(", ".join(by), []).append(name)
        named = "; ".join(f"{by} of {', '.join(names)}" for by, names in inputs.items())
        if not wrong:
            return f"less accurate than allowed: {named} ({self.subject})"
        images = ", ".join(x for x in IMAGES if any(row.name == x for row in wrong))
        first = f"your image differs in {images}; " if images else ""
        return f"WRONG: {first}{named} ({self.subject})"

    def table(self) -> str:
        """Return all comparisons and the verdict as text."""
        rows = [("method", "of", "error", "allowed", "worst", "at", "")]
        for row in self.rows:
            figures = (f"{x:.1e}" for x in (row.error, row.tolerance, row.worst))
            where = str(list(row.where)) if row.where else "a direction"
            rows.append((row.method, row.name, *figures, where, "" if row.passed else "<- FAILS"))
        return "\n".join([*aligned(rows, left=(0, 1, 5)), *self.notes, self.verdict])

    def to_dict(self) -> dict:
        """Return the report for JSON."""
        rows = [asdict(row) | {"passed": row.passed} for row in self.rows]
        found = {"passed": self.passed, "verdict": self.verdict, "subject": self.subject}
        return found | {"notes": list(self.notes), "rows": rows}


def write_reports(reports: dict[str, Report], path: Path) -> None:
    """Write all reports by the names of their scenes, and one verdict over all of them.

    Example:
        >>> import json, tempfile
        >>> path = Path(tempfile.mkdtemp()) / "gradcheck.json"
        >>> write_reports({"empty": Report((), "0 Gaussians")}, path)
        >>> json.loads(path.read_text())["passed"]
        True
    """
    passed = all(report.passed for report in reports.values())
    write_json(path, {"passed": passed, "scenes": {k: r.to_dict() for k, r in reports.items()}})
