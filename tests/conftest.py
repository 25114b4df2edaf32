"""What every test runs with, and the robot that several of them look at."""

import os

import pytest

# Small matrices and parallel tests: threads inside the linear algebra only get in each other's way. Set before numpy loads.
for variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")


@pytest.fixture(scope="session")
def body():
    """The biped that ships with gainroom."""
    from robot_truths import biped

    return biped()


@pytest.fixture(scope="module")
def browser():
    """A browser without a window, for the tests of the interactive page."""
    from app_pages import a_browser

    with a_browser() as found:
        yield found


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The tutorial's robot takes longest: it comes first, so that no process is left with it alone at the end."""
    items.sort(key=lambda item: "tutorial_humanoid" not in item.nodeid)
