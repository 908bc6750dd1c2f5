"""Normal equations of a video: frames that neighbours couple, and unknowns that all frames share.

Of F unknowns a frame and S shared ones, a Gauss-Newton step solves

1. ``[ H_ff  H_fs ] [x]   [g_f]``
   ``[ H_sf  H_ss ] [y] = [g_s]``

``H_ff`` couples a frame with the next two only. Two frames make a block, blocks are tridiagonal,
and their Cholesky factors take time and memory in proportion to the number of frames:

2. ``L_i L_iᵀ = D_i - W_i-1 W_i-1ᵀ``,   ``W_i = E_i L_i⁻ᵀ``     ``E_i``: block ``(i + 1, i)``

The shared unknowns follow from the Schur complement ``H_ss - H_sf H_ff⁻¹ H_fs``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from gva_mi.body.so3 import compose

FRAMES_AT_ONCE = 32  # frames whose derivatives are in memory at once
UNDETERMINED = 1e-6  # added to the diagonal


@dataclass(frozen=True)
class Stage1State:
    """Poses of T frames, and what all frames share; float64.

    Attributes:
        rotations: (T, 55, 3) axis-angle; the root's relative to the camera's axes.
        place: (T, 3) of the root joint, metres.
        betas: (B,).
        focal: the logarithm of a factor on the camera's focal length, ().
        up: (2,) the world's upward direction is that of ``(up_0, -1, up_1)``.
        floor: () height of the camera above the floor, metres.
        offsets: (P, 3) constant offsets of the landmarks, metres.
        angle_offsets: (Q,) constant offsets of the angles that anatomy holds at zero, radians.
    """

    rotations: Tensor
    place: Tensor
    betas: Tensor
    focal: Tensor
    up: Tensor
    floor: Tensor
    offsets: Tensor
    angle_offsets: Tensor

    def upward(self) -> tuple[Tensor, Tensor]:
        """Return the unit vector upward (3,), and its derivative (3, 2) by ``up``."""
        n = torch.stack([self.up[0], -torch.ones_like(self.up[0]), self.up[1]])
        length, unit = n.norm(), n / n.norm()
        across = torch.eye(3, dtype=n.dtype) - unit[:, None] * unit
        return unit, across[:, [0, 2]] / length


@dataclass(frozen=True)
class Free:
    """The unknowns of one problem, as columns: those of a frame, then those that frames share.

    Shared columns are counted from the first of them on.

    Attributes:
        joints: that may turn; with the root (first) the person may also travel.
        betas: number of them.
        camera: whether focal length, upward direction and floor are unknown.
        offsets: landmarks whose offsets are unknown.
        angle_offsets: angles whose offsets are unknown.
    """

    joints: Sequence[int]
    betas: int = 0
    camera: bool = False
    offsets: Sequence[int] = ()
    angle_offsets: Sequence[int] = ()

    @property
    def travels(self) -> bool:
        return 0 in self.joints

    @property
    def per_frame(self) -> int:
        """F, columns of a frame: place, if the person travels, then joints."""
        return 3 * (len(self.joints) + self.travels)

    @property
    def shared(self) -> int:
        """S."""
        return self.betas + 4 * self.camera + 3 * len(self.offsets) + len(self.angle_offsets)

    @property
    def first_of_camera(self) -> int:
        """Shared column of the focal length; those of up and the floor follow."""
        return self.betas

    @property
    def first_of_offsets(self) -> int:
        return self.first_of_camera + 4 * self.camera

    @property
    def first_of_angle_offsets(self) -> int:
        return self.first_of_offsets + 3 * len(self.offsets)

    def moved(self, state: Stage1State, step: Tensor, shared: Tensor) -> Stage1State:
        """Apply a step (T, F) and (S,)."""
        turns = step.unflatten(1, (-1, 3))
        place, rotations = state.place, state.rotations.clone()
        if self.travels:
            place, turns = place + turns[:, 0], turns[:, 1:]
            rotations[:, 0] = compose(rotations[:, 0], turns[:, 0])
            rotations[:, list(self.joints[1:])] += turns[:, 1:]
        else:
            rotations[:, list(self.joints)] += turns
        camera, angle_offsets = self.first_of_camera, self.first_of_angle_offsets
        betas, moved, held = state.betas.clone(), state.offsets.clone(), state.angle_offsets.clone()
        betas[: self.betas] += shared[: self.betas]
        moved[list(self.offsets)] += shared[self.first_of_offsets : angle_offsets].view(-1, 3)
        held[list(self.angle_offsets)] += shared[angle_offsets:]
        found = replace(
            state, rotations=rotations, place=place, betas=betas, offsets=moved, angle_offsets=held
        )
        if not self.camera:
            return found
        focal, up, floor = shared[camera], shared[camera + 1 : camera + 3], shared[camera + 3]
        return replace(
            found, focal=state.focal + focal, up=state.up + up, floor=state.floor + floor
        )


@dataclass
class NormalEquations:
    """A sum of squares around the current unknowns; float64.

    Attributes:
        frames: (T, F, F) diagonal blocks of ``H_ff``.
        next, second: (T, F) diagonals of the blocks that couple frame ``t`` with ``t + 1``, and
            with ``t + 2``; zero where there is none.
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
    def zero(frames: int, free: int, shared: int) -> NormalEquations:
        """Start an empty sum."""
        z = lambda *shape: torch.zeros(*shape, dtype=torch.float64)
        return NormalEquations(
            z(frames, free, free), z(frames, free), z(frames, free), z(frames, free, shared),
            z(shared, shared), z(frames, free), z(shared),
        )  # fmt: skip

    def add(
        self, some: slice, r: Tensor, weights: Tensor, by_frame: Tensor, by_shared: Tensor
    ) -> None:
        """Add weighted squares ``Σ w r² / 2`` of n frames.

        Args:
            some: the frames.
            r, weights: (n, N).
            by_frame, by_shared: (n, N, F) and (n, N, S), derivatives of r.
        """
        weighted = weights[..., None] * by_frame
        self.frames[some] += weighted.mT @ by_frame
        self.pull[some] -= torch.einsum("nkf,nk->nf", weighted, r)
        if by_shared.any():
            self.mixed[some] += weighted.mT @ by_shared
            flat = by_shared.flatten(0, 1)
            weighted = weights.flatten()[:, None] * flat
            self.shared += weighted.T @ flat
            self.shared_pull -= weighted.T @ r.flatten()

    def add_steps(
        self, steps: Tensor, weight: float | Tensor, columns: slice = slice(None)
    ) -> None:
        """Add weighted squares of the steps (T - 1, n) from frame to frame of n columns."""
        diagonal = self.frames.diagonal(dim1=1, dim2=2)[:, columns]
        diagonal[1:] += weight
        diagonal[:-1] += weight
        self.next[:-1, columns] -= weight
        self.pull[1:, columns] -= weight * steps
        self.pull[:-1, columns] += weight * steps

    def solve(self, damping: float) -> tuple[Tensor, Tensor]:
        """Return the step (T, F) and (S,), with the diagonal ``1 + damping`` times as large."""
        count, free = self.pull.shape
        more = 1 + damping
        frames = self.frames.clone()
        # What nothing determines, such as the place of a single frame without pictures, stays.
        frames.diagonal(dim1=1, dim2=2).mul_(more).add_(UNDETERMINED)
        known = torch.cat([self.mixed, self.pull[..., None]], -1)
        factors = _Factors.of(*_in_pairs(frames, self.next, self.second))
        padded = torch.nn.functional.pad(known, (0, 0, 0, 0, 0, count % 2))
        solved = factors.solve(padded.reshape(-1, 2 * free, known.shape[-1]))
        solved = solved.reshape(-1, free, known.shape[-1])[:count]
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
    """Eq. 2: N lower factors (b, b), and N - 1 of ``W``."""

    lower: list[Tensor]
    across: list[Tensor]

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
        """Solve for (N, b, k)."""
        solve = torch.linalg.solve_triangular
        found = list(known)
        for i, L in enumerate(self.lower):
            right = found[i] if not i else found[i] - self.across[i - 1] @ found[i - 1]
            found[i] = solve(L, right, upper=False)
        for i in reversed(range(len(found))):
            later = i + 1 < len(found)
            right = found[i] - self.across[i].mT @ found[i + 1] if later else found[i]
            found[i] = solve(self.lower[i].mT, right, upper=True)
        return torch.stack(found)


def _in_pairs(frames: Tensor, following: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
    """Return diagonal blocks (N, 2F, 2F) of pairs of frames, and those below (N - 1, 2F, 2F)."""
    count, free = following.shape
    if count % 2:  # a frame that nothing couples
        one = torch.eye(free, dtype=frames.dtype)
        frames = torch.cat([frames, one[None]])
        following, second = (torch.cat([x, 0 * x[:1]]) for x in (following, second))
    pairs = len(frames) // 2
    diagonal = frames.new_zeros(pairs, 2 * free, 2 * free)
    first, other = slice(None, free), slice(free, None)
    diagonal[:, first, first], diagonal[:, other, other] = frames[::2], frames[1::2]
    diagonal[:, other, first] = torch.diag_embed(following[::2])
    diagonal[:, first, other] = diagonal[:, other, first]
    below = frames.new_zeros(max(pairs - 1, 0), 2 * free, 2 * free)
    below[:, first, first] = torch.diag_embed(second[:-2:2])
    below[:, other, other] = torch.diag_embed(second[1:-2:2])
    below[:, first, other] = torch.diag_embed(following[1:-1:2])
    return diagonal, below
