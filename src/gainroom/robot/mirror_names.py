"""Joints that are images of each other, by their names: left and right ones, and those of several legs."""

import re
from collections.abc import Sequence

SIDES = {
    "left",
    "right",
    "l",
    "r",
    *(f"{row}{side}" for row in "frhb" for side in "lr"),
    *(f"{side}{row}" for row in "frhb" for side in "lr"),
}
SIDES |= {"front", "rear", "hind", "back", "fore", "middle"}
"""Words of a name that say which of several alike limbs a joint is in."""
_WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+|[^A-Za-z\d]+")


def without_side(name: str) -> str:
    """A joint's name without the words of SIDES: the same for joints that are images of each other."""
    words = _WORDS.findall(name)
    return "".join("" if word.lower() in SIDES else word for word in words).strip("_- ./")


def image_groups(names: Sequence[str]) -> tuple[int, ...]:
    """(n,) by joint the place of the first of its images; its own where it has none before it."""
    first: dict[str, int] = {}
    stems = [without_side(name) or name for name in names]
    return tuple(first.setdefault(stem, k) for k, stem in enumerate(stems))
