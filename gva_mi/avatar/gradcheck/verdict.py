"""What a check of an avatar's gradients found: figures of the chain, of each link, a verdict."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from gva_mi.splat.gradcheck.verdict import COARSE, HEAD, Comparison


def coarse(row: Comparison) -> bool:
    """Whether a comparison fails by few digits in float32, and not by a fault."""
    return not row.passed and row.method.endswith("f32") and row.error < COARSE


@dataclass(frozen=True)
class LinkReport:
    """One link at the place where the chain uses it."""

    name: str
    rows: tuple[Comparison, ...]  # float64 against its slow twin, and float32 against float64
    alone32: float  # error of the chain's gradient where this link alone computes in float32
    alone32_of: str  # the input whose gradient that is

    @property
    def passed(self) -> bool:
        """Whether every row passes."""
        return all(row.passed for row in self.rows)

    @property
    def coarse(self) -> bool:
        """Whether it fails by its digits in float32 alone."""
        return not self.passed and all(row.passed or coarse(row) for row in self.rows)


@dataclass(frozen=True)
class Report:
    """All comparisons of one avatar in one pose."""

    rows: tuple[Comparison, ...]  # of the whole chain, as a fit computes it
    links: tuple[LinkReport, ...]
    gaussians: int
    pixels: int
    band: int  # pixels at a step of the picture, left out

    @property
    def passed(self) -> bool:
        """Whether the chain and all its links pass."""
        return all(part.passed for part in (*self.rows, *self.links))

    @property
    def coarsest(self) -> LinkReport:
        """The link that loses the most digits."""
        return max(self.links, key=lambda link: link.alone32)

    @property
    def verdict(self) -> str:
        """What was found, in one sentence."""
        off = [row for row in self.rows if not row.passed]
        failed = ", ".join(f"{row.method} of {row.name}" for row in off)
        wrong = [link.name for link in self.links if not link.passed and not link.coarse]
        if wrong:
            found = f"WRONG in {', '.join(wrong)}"
        elif not all(map(coarse, off)):
            found = "WRONG: every link is right alone, but not as Avatar.animate puts them together"
            found = f"{found}: {failed}"
        elif not self.passed:
            found = f"less accurate than allowed, most by {self.coarsest.name}: {failed}"
        else:
            count = len(self.rows) + sum(len(link.rows) for link in self.links)
            found = f"all {count} comparisons pass"
        scene = f"{self.gaussians} Gaussians, {self.pixels} pixels, {self.band} at a step left out"
        return f"{found} ({scene})"

    def table(self) -> str:
        """Everything as text, for a person to read."""
        lines = ["the whole chain:", HEAD, *(row.line for row in self.rows)]
        lines += ["", "its links, each alone:", HEAD]
        lines += [row.line for link in self.links for row in link.rows]
        lines += ["", "the chain's gradients, where one link alone computes in float32:"]
        for link in sorted(self.links, key=lambda link: -link.alone32):
            lines.append(f"{link.name:15} {link.alone32:8.1e}  of {link.alone32_of}")
        return "\n".join([*lines, "", self.verdict])

    def to_dict(self) -> dict:
        """Everything, for JSON."""
        row = lambda r: asdict(r) | {"passed": r.passed}
        links = {
            link.name: {
                "passed": link.passed,
                "alone32": link.alone32,
                "alone32_of": link.alone32_of,
                "rows": [row(r) for r in link.rows],
            }
            for link in self.links
        }
        names = ("passed", "verdict", "gaussians", "pixels", "band")
        found = {name: getattr(self, name) for name in names}
        return found | {"rows": [row(r) for r in self.rows], "links": links}
