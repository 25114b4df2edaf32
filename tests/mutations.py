"""Damage to a file's data, for tests that nothing of it leads to a traceback."""

import copy

from hypothesis import strategies as st

JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**20), 10**20),
    st.floats(),
    st.sampled_from([0, -1, 1e-300, 1e300, 1e12, 1e-12, 1e5, 1e-5, "20%", "2 ms", "motor", "link", "pid", "ppi", [1, 2], {"kp": 1}]),
    st.text(max_size=8),
    st.lists(st.floats(), max_size=3),
    st.dictionaries(st.text(max_size=4), st.floats(), max_size=2),
)
ACTIONS = ("drop", "rename", "replace", "replace", "scale", "swap", "wrap")


def mutated_data(draw: st.DrawFn, data: object) -> object:
    """A file's data with one thing changed, somewhere."""
    spots = []

    def visit(node: object) -> None:
        items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
        for key, value in items:
            spots.append((node, key))
            visit(value)

    visit(data)
    if not spots:
        return copy.deepcopy(draw(JUNK))
    node, key = draw(st.sampled_from(spots))
    action = draw(st.sampled_from(ACTIONS))
    if action == "drop":
        del node[key]
    elif action == "rename" and isinstance(node, dict):
        node[draw(st.one_of(st.just(key + "s"), st.just(key[1:]), st.text(max_size=5)))] = node.pop(key)
    elif action == "scale" and isinstance(node[key], int | float):
        node[key] = node[key] * draw(st.sampled_from([-1, 1e-9, 1e-3, 0.1, 3, 10, 1e3, 1e9]))
    elif action == "swap":
        other, other_key = draw(st.sampled_from(spots))
        # A node put inside itself would be no file.
        if not isinstance(node[key], dict | list) and not isinstance(other[other_key], dict | list):
            node[key], other[other_key] = other[other_key], node[key]
    elif action == "wrap":
        node[key] = [node[key]]
    else:
        node[key] = copy.deepcopy(draw(JUNK))  # it may be mutated next
    return data
