"""An avatar file without the licensed body model, so that it may be given away.

A normal avatar file contains the rest body: vertices, faces, skinning weights, joints, and the
directions of its blend shapes. This format leaves them out and reads them from the reader's own
body file. It keeps what belongs to the person:

* the Gaussians: parameters, and their skinning weights;
* ``beneath`` and ``shares``, (N, k): the body's vertices that a Gaussian takes its blend shapes
  from, and their shares;
* ``offsets`` (V, 3): distance of the clothes from the body, metres; and ``betas``;
* the name of the body, and a fingerprint of all its numbers.

The format is ours.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gva_mi.avatar.avatar import FORMAT, SKIN_ARRAYS, Avatar, AvatarOptions, tensors_of
from gva_mi.avatar.rig import RIG_TENSORS, Rig, digest, mean_directions
from gva_mi.body.pose import Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import write_arrays
from gva_mi.core.options import from_json

WITHOUT_BODY = "gva_mi avatar without its body, version 1"
DIRECTIONS = "canonical.directions"  # of the Gaussians' blend shapes: means of the body's
_OF_BODY = ("rest_", "skin_")  # prefixes of the body's own numbers


def body_hash(body: BodyModel) -> str:
    """Return a hash of all numbers of a body model.

    Example:
        >>> from gva_mi.body.smplx import load_body
        >>> body_hash(load_body()) == body_hash(load_body())
        True
    """
    found = hashlib.sha256()
    for name, value in sorted(body.named_buffers()):
        found.update(f"{name} {tuple(value.shape)}".encode())
        found.update(np.ascontiguousarray(value.numpy()).tobytes())
    return found.hexdigest()[:16]


def require_body_of(avatar: Avatar, body: BodyModel, name: str) -> None:
    """Raise an InputError unless an avatar was made with this body, called ``name``.

    Example:
        >>> from gva_mi.avatar.avatar import SeedOptions, seed_avatar
        >>> from gva_mi.body.smplx import load_body
        >>> body, options = load_body(), AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(body, Shape(torch.zeros(10)), options=options)
        >>> require_body_of(avatar, body, "built-in")
    """
    rig = avatar.rig
    same = rig.body == digest(body) and torch.equal(rig.weights, body.weights)
    if not (same and torch.equal(rig.pose_features, body.pose_features)):
        raise InputError(
            f"the avatar was made with another body ({rig.body}) than {name} ({digest(body)}); "
            "pass the matching body with --body"
        )


def save_without_body(path: Path, avatar: Avatar, body: BodyModel, name: str) -> None:
    """Write an avatar without its body, atomically.

    ``name`` is the body's, for readers of the file.

    Raises:
        InputError: the avatar was made with another body.

    Example:
        >>> import tempfile
        >>> from gva_mi.avatar.avatar import SeedOptions, seed_avatar
        >>> from gva_mi.body.smplx import load_body
        >>> body, options = load_body(), AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(body, Shape(torch.zeros(10)), options=options)
        >>> path = Path(tempfile.mkdtemp()) / "avatar.npz"
        >>> save_without_body(path, avatar, body, "built-in")
        >>> with np.load(path) as file:  # no number of the body is there
        ...     [name for name in file if name.startswith(_OF_BODY)]
        []
    """
    require_body_of(avatar, body, name)
    rig, skin, record = avatar.rig, avatar.skin, avatar.record()
    described = json.loads(record.pop("description"))
    described["body"] = {"name": name, "digest": rig.body, "fingerprint": body_hash(body)}
    of_person = {
        key: np.asarray(value)
        for key, value in record.items()
        if key not in ("format", DIRECTIONS) and not key.startswith(_OF_BODY)
    }
    shares, around = skin.around(avatar.canonical.means)
    naked = Rig.of(body, Shape(rig.betas)).vertices
    write_arrays(
        path,
        **of_person,
        format=np.array(WITHOUT_BODY),
        description=np.array(json.dumps(described)),
        betas=rig.betas.numpy(),
        offsets=(rig.vertices - naked).numpy(),
        beneath=skin.beneath[around].numpy().astype(np.int32),
        shares=shares.numpy(),
    )


def with_body(path: Path, arrays: dict[str, np.ndarray], body: BodyModel, name: str) -> Avatar:
    """Restore the avatar from the arrays of a file without a body.

    Its outer skin is the body's surface, displaced by the clothes.

    Raises:
        InputError: not such a file, or it belongs to another body than ``body``, called ``name``.

    Example:
        >>> import tempfile
        >>> from gva_mi.avatar.avatar import SeedOptions, seed_avatar
        >>> from gva_mi.body.smplx import load_body
        >>> from gva_mi.core.files import read_arrays
        >>> body, options = load_body(), AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(body, Shape(torch.zeros(10)), options=options)
        >>> path = Path(tempfile.mkdtemp()) / "avatar.npz"
        >>> save_without_body(path, avatar, body, "built-in")
        >>> restored = with_body(path, read_arrays(path, "an avatar"), body, "built-in")
        >>> torch.equal(restored.canonical.means, avatar.canonical.means)
        True
    """
    with expecting(path, "an avatar of this version"):
        described = json.loads(str(arrays.pop("description")))
        wanted, found = described["body"], body_hash(body)
        if wanted["fingerprint"] != found:
            raise InputError(
                f"{path}: holds no body and belongs to '{wanted['name']}' "
                f"({wanted['fingerprint']}), not to '{name}' ({found}); pass the matching body "
                "with --body"
            )
        record: dict[str, Any] = dict(tensors_of(path, arrays))
        shares, beneath = record.pop("shares"), record.pop("beneath")
        rig = Rig.of(body, Shape(record.pop("betas")), record.pop("offsets"))
        record[DIRECTIONS] = mean_directions(shares, beneath, rig.directions)
        record |= {f"rest_{key}": getattr(rig, key) for key in RIG_TENSORS}
        skin = rig.outer_skin(from_json(AvatarOptions, described["options"]).skinning)
        record |= {f"skin_{key}": getattr(skin, key) for key in SKIN_ARRAYS}
        described["body"] = rig.body
        return Avatar.from_record(record | {"format": FORMAT, "description": json.dumps(described)})
