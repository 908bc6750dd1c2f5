"""What gsplat's ``meta`` holds beside the pictures, made when somebody asks for it.

Most programs read a few of its entries, and only in some steps. So an entry is a recipe until it is
read, and then its value: ``meta`` costs what is used of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, MutableMapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

Recipe = Callable[[], Any]


class Meta(MutableMapping):
    """A dictionary some of whose values are made at their first reading."""

    def __init__(self, values: dict[str, Any], recipes: dict[str, Recipe]) -> None:
        self._values, self._recipes = dict(values), dict(recipes)

    def __getitem__(self, name: str) -> Any:  # noqa: ANN401
        if name not in self._values and name in self._recipes:
            self._values[name] = self._recipes.pop(name)()
        return self._values[name]

    def __setitem__(self, name: str, value: Any) -> None:  # noqa: ANN401
        self._recipes.pop(name, None)
        self._values[name] = value

    def __delitem__(self, name: str) -> None:
        if self._recipes.pop(name, None) is None:
            del self._values[name]

    def __iter__(self) -> Iterator[str]:
        yield from [*self._values, *self._recipes]

    def __len__(self) -> int:
        return len(self._values) + len(self._recipes)

    def __repr__(self) -> str:
        return f"Meta({', '.join(self)})"


@dataclass(frozen=True)
class Tiles:
    """Square tiles of the pictures, and who touches them: gsplat's, which the kernels do not use.

    A Gaussian touches the tiles that its box of whole pixels does: more than its ellipse.
    """

    size: int  # px
    width: int  # tiles side by side
    height: int
    counts: Tensor  # of each row of Gaussians: tiles touched, int32
    keys: Tensor  # of each pair: image, tile, depth, as bits of an int64, sorted
    rows: Tensor  # of each pair, the row of its Gaussian, int32
    offsets: Tensor  # (images, height, width) where the list of each tile starts, int32

    @staticmethod
    def of(
        means2d: Tensor,
        boxes: Tensor,
        depths: Tensor,
        images: Tensor,
        count: int,
        picture: tuple[int, int],
        size: int,
        sort: bool = True,
    ) -> Tiles:
        """The tiles of ``count`` pictures.

        Args:
            means2d: (M, 2) px, of all pictures' Gaussians.
            boxes: (M, 2) px, half extents; 0 where outside.
            depths: (M,) m.
            images: (M,) which picture.
            count: of pictures.
            picture: width and height, px.
            size: of a tile, px.
            sort: by ``keys``; else pairs lie in the order of the rows, and offsets mean nothing.
        """
        width, height = (-(-side // size) for side in picture)
        most = torch.tensor([width, height])
        low = ((means2d - boxes) / size).floor().long().clamp(min=0).minimum(most)
        high = ((means2d + boxes) / size).ceil().long().clamp(min=0).minimum(most)
        sides = torch.where((boxes > 0).all(dim=1, keepdim=True), high - low, 0)
        counts = sides.prod(dim=1)
        rows = torch.repeat_interleave(torch.arange(len(counts)), counts)
        within = torch.arange(len(rows)) - (counts.cumsum(0) - counts)[rows]
        columns = sides[rows, 0]
        tile = (low[rows, 1] + within // columns) * width + low[rows, 0] + within % columns
        tile = images[rows] * (width * height) + tile  # of all pictures
        bits = depths.to(torch.float32).view(torch.int32).long()[rows] & 0xFFFFFFFF
        bits_of_a_tile = (width * height).bit_length()
        image, place = tile // (width * height), tile % (width * height)
        keys = (((image << bits_of_a_tile) | place) << 32) | bits
        if sort:
            keys, order = torch.sort(keys, stable=True)
            tile, rows = tile[order], rows[order]
        starts = torch.searchsorted(tile, torch.arange(count * width * height))
        offsets = starts.view(count, height, width).int()
        return Tiles(size, width, height, counts.int(), keys, rows.int(), offsets)
