"""Mirror-image joints by name: left and right ones, and those of several legs."""

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
    """Joint name without the words of SIDES, equal for mirror images."""
    words = _WORDS.findall(name)
    return "".join("" if word.lower() in SIDES else word for word in words).strip("_- ./")


def image_groups(names: Sequence[str]) -> tuple[int, ...]:
    """Index (n,) of the first mirror image of each joint; its own index where none comes before it."""
    first: dict[str, int] = {}
    stems = [without_side(name) or name for name in names]
    return tuple(first.setdefault(stem, k) for k, stem in enumerate(stems))


def images(names: Sequence[str]) -> tuple[tuple[int, ...], ...]:
    """Groups of joints, by index, that are mirror images of each other; every joint is in one."""
    of = image_groups(names)
    return tuple(tuple(k for k, first in enumerate(of) if first == one) for one in dict.fromkeys(of))
