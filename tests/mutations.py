"""Damage to files, for tests that nothing of it leads to a traceback.

Every choice is one of a `random.Random`: seeded, a population can be drawn again; Hypothesis's own (`st.randoms()`) shrinks what it finds.
"""

import copy
from collections.abc import Callable
from random import Random
from typing import Any
from xml.etree.ElementTree import Element, fromstring, tostring

from hypothesis import strategies as st

RANDOMS = st.randoms(use_true_random=False)

ODD = (0, -1, 1e-300, 1e300, 1e12, 1e-12, 1e5, 1e-5, "20%", "2 ms", "motor", "link", "pid", "ppi", [1, 2], {"kp": 1})
FLOATS = (0.0, -0.0, 1.5, -2.5, float("nan"), float("inf"), -float("inf"), 5e-324, 2.2e-16, 1e-9, 1e9, 1e16, 1e150, 1.7e308)
LETTERS = "aZ0_ .:*+([{|\\\"'<>&#%~-\t\x00\x1b\x7fµ漢\ud800"
ACTIONS = ("drop", "rename", "replace", "scale", "scale", "number", "number", "swap", "wrap")
SIZES = (0, -1, 1e-300, 1e-13, 1e-12, 1e-9, 1e-6, 1e-3, 1, 1e3, 1e4, 1e6, 1e9, 1e12, 1.1e12, 1e150, 1.7e308, float("inf"), float("nan"))
FACTORS = (-1, 1e-9, 1e-3, 0.1, 3, 10, 1e3, 1e6, 1e9, 1e12)

# What XML numbers become, also one by one in a list, and names: those that libraries keep for themselves among them.
NUMBERS = (
    "0",
    "-1",
    "1e-300",
    "1e-12",
    "1e5",
    "1e12",
    "1e200",
    "1e300",
    "1.7e308",
    "1e999",
    "-1e200",
    "nan",
    "inf",
    "-inf",
    "0x10",
    "1,5",
    "x",
    "",
)
NAMES = ("universe", "world", "root_joint", "base", "floating base", "", " ", "a\u202eb", "x" * 300, "link:base", "body#1")
XML_ACTIONS = (
    "drop",
    "double",
    "rename",
    "number",
    "number",
    "number",
    "all numbers",
    "scale",
    "name",
    "name",
    "unset",
    "misspell",
    "move",
    "swap",
)


def some_float(random: Random) -> float:
    return random.choice(FLOATS) if random.random() < 0.5 else random.uniform(-10, 10) * 10.0 ** random.randint(-12, 12)


def some_text(random: Random, most: int = 8) -> str:
    return "".join(random.choice(LETTERS) for _ in range(random.randint(0, most)))


KINDS: tuple[Callable[[Random], Any], ...] = (
    lambda random: None,
    lambda random: random.random() < 0.5,
    lambda random: random.randint(-(10**20), 10**20),
    some_float,
    lambda random: copy.deepcopy(random.choice(ODD)),
    some_text,
    lambda random: [some_float(random) for _ in range(random.randint(0, 3))],
    lambda random: {some_text(random, 4): some_float(random) for _ in range(random.randint(0, 2))},
)


def junk(random: Random) -> Any:
    """Anything that YAML can hold."""
    return random.choice(KINDS)(random)


def mutated_data(random: Random, data: Any) -> Any:
    """A file's data with one thing changed, somewhere."""
    spots = []

    def visit(node: Any) -> None:
        items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
        for key, value in items:
            spots.append((node, key))
            visit(value)

    visit(data)
    if not spots:
        return junk(random)
    action = random.choice(ACTIONS)
    numbers = [(node, key) for node, key in spots if isinstance(node[key], int | float)]
    node, key = random.choice(numbers if numbers and action in ("scale", "number") else spots)
    if action == "drop":
        del node[key]
    elif action == "rename" and isinstance(node, dict):
        node[random.choice([key + "s", key[1:], some_text(random, 5)])] = node.pop(key)
    elif action == "scale" and isinstance(node[key], int | float):
        node[key] = node[key] * random.choice(FACTORS)
    elif action == "number":
        node[key] = random.choice(SIZES)
    elif action == "swap":
        other, other_key = random.choice(spots)
        # A node put inside itself would be no file.
        if not isinstance(node[key], dict | list) and not isinstance(other[other_key], dict | list):
            node[key], other[other_key] = other[other_key], node[key]
    elif action == "wrap":
        node[key] = [node[key]]
    else:
        node[key] = junk(random)
    return data


def mutated_bytes(random: Random, content: bytes, inserts: tuple[bytes, ...]) -> bytes:
    """A text with one place of it damaged; `inserts` mean something in its language."""
    raw = bytearray(content)
    position = random.randrange(len(raw))
    match random.choice(("flip", "drop", "double", "insert", "cut")):
        case "flip":
            raw[position] ^= 1 << random.randint(0, 7)
        case "drop":
            del raw[position : position + random.randint(1, 20)]
        case "double":
            raw[position:position] = raw[position : position + 40]
        case "insert":
            raw[position:position] = random.choice(inserts)
        case "cut":
            del raw[position:]
    return bytes(raw)


def mutated_xml(random: Random, text: str) -> str:
    """An XML text with one thing changed: an element, an attribute, a number or a name."""
    root = fromstring(text)
    parents = {child: parent for parent in root.iter() for child in parent}
    element = random.choice([root, *parents])
    attributes = [(each, key) for each in [root, *parents] for key in each.attrib]
    numbers = [(each, key) for each, key in attributes if _is_numbers(each.get(key, ""))]
    names = [(each, key) for each, key in attributes if (each, key) not in numbers]
    action = random.choice(XML_ACTIONS)
    if action in ("drop", "double", "move", "rename") and element is not root:
        _change_element(random, action, element, parents, root)
    elif action in ("number", "all numbers", "scale") and numbers:
        each, key = random.choice(numbers)
        words = each.get(key, "").split()
        chosen = range(len(words)) if action == "all numbers" else [random.randrange(len(words))]
        for place in chosen:
            scaled = f"{float(words[place]) * random.choice(FACTORS):.9g}"
            words[place] = scaled if action == "scale" else random.choice(NUMBERS)
        each.set(key, " ".join(words))
    elif action == "name" and names:
        each, key = random.choice(names)
        other, other_key = random.choice(names)
        each.set(key, random.choice([*NAMES, other.get(other_key, ""), other.get(other_key, "")]))
    elif action == "swap" and attributes:
        (each, key), (other, other_key) = random.choice(attributes), random.choice(attributes)
        value, other_value = each.get(key, ""), other.get(other_key, "")
        each.set(key, other_value)
        other.set(other_key, value)
    elif attributes:
        each, key = random.choice(attributes)
        value = each.attrib.pop(key)
        if action == "misspell":
            each.set(key[:-1] or "x", value)
    return tostring(root, "unicode")


def _is_numbers(text: str) -> bool:
    try:
        return bool([float(word) for word in text.split()])
    except ValueError:
        return False


def _change_element(random: Random, action: str, element: Element, parents: dict[Element, Element], root: Element) -> None:
    parent = parents[element]
    if action == "rename":
        element.tag = random.choice([element.tag + "s", element.tag[:-1] or "x", random.choice(list(parents)).tag])
    elif action == "double":
        parent.append(copy.deepcopy(element))
    else:
        parent.remove(element)
        outside = [each for each in (root, *parents) if each not in set(element.iter())]
        if action == "move":
            random.choice(outside).append(element)
