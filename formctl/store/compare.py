"""Settings side by side: what differs, and a short name for all of it."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from formctl.store.files import plain

ABSENT = "(absent)"


def flatten(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Dotted keys to leaves; lists are leaves."""
    leaves: dict[str, Any] = {}
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            leaves |= flatten(value, f"{name}.")
        else:
            leaves[name] = plain(value)
    return leaves


def differences(ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Dotted keys whose values differ, with both values; ABSENT where a side lacks the key."""
    left, right = flatten(ours), flatten(theirs)
    pairs = {key: (left.get(key, ABSENT), right.get(key, ABSENT)) for key in left | right}
    return {key: pair for key, pair in pairs.items() if pair[0] != pair[1]}


def fingerprint(tree: Mapping[str, Any]) -> str:
    """Twelve hexadecimal digits that change with any leaf, and with nothing else."""
    text = json.dumps(flatten(tree), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:12]
