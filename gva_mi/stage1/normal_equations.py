"""Normal equations of a video: neighbouring frames are coupled, some unknowns are shared by all.

With F unknowns per frame and S shared unknowns, a Gauss-Newton step solves

1. ``[ H_ff  H_fs ] [x]   [g_f]``
   ``[ H_sf  H_ss ] [y] = [g_s]``

``H_ff`` couples a frame with the next two only. Two frames make a block, blocks are tridiagonal,
and their Cholesky factors take time and memory in proportion to the number of frames:

2. ``L_i L_iᵀ = D_i - W_i-1 W_i-1ᵀ``,   ``W_i = E_i L_i⁻ᵀ``     ``E_i``: block ``(i + 1, i)``

The shared unknowns follow from the Schur complement ``H_ss - H_sf H_ff⁻¹ H_fs``.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

FRAMES_AT_ONCE = 32  # frames whose derivatives are in memory at once; chosen to limit memory
DIAGONAL_FLOOR = 1e-6  # added to the diagonal, for unknowns that nothing determines; by eye


@dataclass
class NormalEquations:
    """A sum of squares around the current unknowns; float64.

    Attributes:
        frames: (T, F, F) diagonal blocks of ``H_ff``.
        next, second: (T, F) diagonals of the blocks that couple frame ``t`` with ``t + 1`` and with
            ``t + 2``; zero if that frame does not exist.
        mixed: (T, F, S) ``H_fs``.
        shared: (S, S) ``H_ss``.
        pull, shared_pull: (T, F) and (S,), the negative gradient.
    """

    frames: Tensor
    next: Tensor
    second: Tensor
    mixed: Tensor
    shared: Tensor
    pull: Tensor
    shared_pull: Tensor

    @staticmethod
    def zero(frames: int, F: int, shared: int) -> NormalEquations:
        """Start an empty sum."""
        z = lambda *shape: torch.zeros(*shape, dtype=torch.float64)
        return NormalEquations(
            z(frames, F, F), z(frames, F), z(frames, F), z(frames, F, shared),
            z(shared, shared), z(frames, F), z(shared),
        )  # fmt: skip

    def add(self, frames: slice, r: Tensor, w: Tensor, by_frame: Tensor, by_shared: Tensor) -> None:
        """Add weighted squares ``Σ w r² / 2`` of n frames.

        Args:
            frames: the n frames.
            r: (n, N) residuals.
            w: (n, N) weights.
            by_frame: (n, N, F) ∂r / ∂(unknowns of the frame).
            by_shared: (n, N, S) ∂r / ∂(shared unknowns).
        """
        self.add_shared(self.add_to_frames(frames, r, w, by_frame, by_shared))

    def add_to_frames(
        self, frames: slice, r: Tensor, w: Tensor, by_frame: Tensor, by_shared: Tensor
    ) -> tuple[Tensor, Tensor] | None:
        """Do what :meth:`add` does to the frames; return what :meth:`add_shared` adds.

        Other frames may be added to in other threads.
        """
        weighted = w[..., None] * by_frame
        self.frames[frames] += weighted.mT @ by_frame
        self.pull[frames] -= torch.einsum("nkf,nk->nf", weighted, r)
        if not by_shared.any():
            return None
        self.mixed[frames] += weighted.mT @ by_shared
        flat = by_shared.flatten(0, 1)
        weighted = w.flatten()[:, None] * flat
        return weighted.T @ flat, weighted.T @ r.flatten()

    def add_shared(self, terms: tuple[Tensor, Tensor] | None) -> None:
        """Add to the shared unknowns; the order of calls decides the last bits."""
        if terms is not None:
            self.shared += terms[0]
            self.shared_pull -= terms[1]

    def add_steps(self, steps: Tensor, w: float | Tensor, columns: slice = slice(None)) -> None:
        """Add weighted squares of steps (T - 1, n) from frame to frame, of n columns."""
        diagonal = self.frames.diagonal(dim1=1, dim2=2)[:, columns]
        diagonal[1:] += w
        diagonal[:-1] += w
        self.next[:-1, columns] -= w
        self.pull[1:, columns] -= w * steps
        self.pull[:-1, columns] += w * steps

    def solve(self, damping: float) -> tuple[Tensor, Tensor]:
        """Solve eq. 1, its diagonal times ``1 + damping``, for the step (T, F) and (S,)."""
        count, F = self.pull.shape
        more = 1 + damping
        frames = self.frames.clone()
        # An unknown that nothing determines stays, such as the place of a frame without landmarks.
        frames.diagonal(dim1=1, dim2=2).mul_(more).add_(DIAGONAL_FLOOR)
        known = torch.cat([self.mixed, self.pull[..., None]], -1)
        factors = _Factors.of(*_in_pairs(frames, self.next, self.second))
        padded = torch.nn.functional.pad(known, (0, 0, 0, 0, 0, count % 2))
        solved = factors.solve(padded.reshape(-1, 2 * F, known.shape[-1]))
        solved = solved.reshape(-1, F, known.shape[-1])[:count]
        by_shared, alone = solved[..., :-1], solved[..., -1]
        if not len(self.shared_pull):
            return alone, self.shared_pull
        schur = self.shared.clone()
        schur.diagonal().mul_(more)
        schur -= torch.einsum("tfs,tfr->sr", self.mixed, by_shared)
        pull = self.shared_pull - torch.einsum("tfs,tf->s", self.mixed, alone)
        y = torch.cholesky_solve(pull[:, None], torch.linalg.cholesky(schur))[:, 0]
        return alone - by_shared @ y, y


@dataclass(frozen=True)
class _Factors:
    """Cholesky factors of a block-tridiagonal matrix (eq. 2)."""

    lower: list[Tensor]  # N of ``L`` (b, b)
    across: list[Tensor]  # N - 1 of ``W`` (b, b)

    @staticmethod
    def of(diagonal: Tensor, below: Tensor) -> _Factors:
        lower, across = [], []
        for i, block in enumerate(diagonal):
            if i:
                W = torch.linalg.solve_triangular(lower[-1], below[i - 1].mT, upper=False).mT
                across.append(W)
                block = block - W @ W.mT
            lower.append(torch.linalg.cholesky(block))
        return _Factors(lower, across)

    def solve(self, known: Tensor) -> Tensor:
        """Solve for k right-hand sides (N, b, k)."""
        solve = torch.linalg.solve_triangular
        x = list(known)
        for i, L in enumerate(self.lower):
            right = x[i] if not i else x[i] - self.across[i - 1] @ x[i - 1]
            x[i] = solve(L, right, upper=False)
        for i in reversed(range(len(x))):
            later = i + 1 < len(x)
            right = x[i] - self.across[i].mT @ x[i + 1] if later else x[i]
            x[i] = solve(self.lower[i].mT, right, upper=True)
        return torch.stack(x)


def _in_pairs(frames: Tensor, following: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
    """Return diagonal blocks (N, 2F, 2F) of pairs of frames, and blocks below (N - 1, 2F, 2F)."""
    count, F = following.shape
    if count % 2:  # add a frame without coupling
        frames = torch.cat([frames, torch.eye(F, dtype=frames.dtype)[None]])
        following, second = (torch.cat([x, 0 * x[:1]]) for x in (following, second))
    pairs = len(frames) // 2
    diagonal = frames.new_zeros(pairs, 2 * F, 2 * F)
    first, other = slice(None, F), slice(F, None)
    diagonal[:, first, first], diagonal[:, other, other] = frames[::2], frames[1::2]
    diagonal[:, other, first] = torch.diag_embed(following[::2])
    diagonal[:, first, other] = diagonal[:, other, first]
    below = frames.new_zeros(max(pairs - 1, 0), 2 * F, 2 * F)
    below[:, first, first] = torch.diag_embed(second[:-2:2])
    below[:, other, other] = torch.diag_embed(second[1:-2:2])
    below[:, first, other] = torch.diag_embed(following[1:-1:2])
    return diagonal, below
