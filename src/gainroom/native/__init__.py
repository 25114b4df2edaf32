"""The C++ core: what is hot, and nothing else. Headers in include/gainroom, bound by nanobind as `_core`."""
