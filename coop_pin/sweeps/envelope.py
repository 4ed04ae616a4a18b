"""JSON files that know whether they are whole: a content and the digest of its bytes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from coop_pin.errors import SweepStoreError

_HEAD, _MIDDLE, _TAIL = b'{"content": ', b', "sha256": "', b'"}\n'
_DIGEST = 64


def seal(content: Mapping[str, Any]) -> bytes:
    """Return ``{"content": ..., "sha256": digest of the content's bytes}`` as JSON."""
    body = json.dumps(content, allow_nan=False).encode()
    return _HEAD + body + _MIDDLE + hashlib.sha256(body).hexdigest().encode() + _TAIL


def unseal(data: bytes) -> dict[str, Any]:
    """Return the content.

    Raises:
        SweepStoreError: a bit of it is not as it was written, or it was not written by seal.
    """
    end = len(data) - len(_TAIL) - _DIGEST - len(_MIDDLE)
    if end < len(_HEAD) or not (data.startswith(_HEAD) and data[end : end + len(_MIDDLE)] == _MIDDLE and data.endswith(_TAIL)):
        raise SweepStoreError("the file was not written by a sweep, or is cut off")
    body, digest = data[len(_HEAD) : end], data[end + len(_MIDDLE) : -len(_TAIL)]
    if hashlib.sha256(body).hexdigest().encode() != digest:
        raise SweepStoreError("the file is damaged: its checksum does not fit its content")
    content = json.loads(body)
    if not isinstance(content, dict):
        raise SweepStoreError("the file was not written by a sweep")
    return content
