"""Web pages of avatars, read as their script reads them."""

import base64
import gzip
import json
import re

import numpy as np


def unpack(path):
    """Return the JSON of a page, with its arrays by name as the script reads them."""
    text = path.read_text()
    data = re.search(r'<script id="avatar"[^>]*>([^<]*)<', text).group(1)
    whole = gzip.decompress(base64.b64decode(data))
    length = int.from_bytes(whole[:4], "little")
    described = json.loads(whole[4 : 4 + length])
    for about in described["arrays"]:
        stored = np.frombuffer(whole, "<" + about["kind"], about["count"], 4 + length + about["at"])
        described[about["name"]] = stored * about["step"] if about["step"] else stored
    return described
