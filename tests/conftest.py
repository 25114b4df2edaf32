"""What every test runs with, and the robot that several of them look at."""

import gc
import os
from zlib import crc32

import pytest
from hypothesis import HealthCheck, settings

# Small matrices and parallel tests: threads inside the linear algebra only get in each other's way. Set before numpy loads.
for variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

# What a terminal, a time zone or a service for tests would change in what is printed.
os.environ |= {"COLUMNS": "80", "TZ": "UTC"}
for variable in ("FORCE_COLOR", "NO_COLOR", "PY_COLORS", "GITHUB_ACTIONS", "TTY_COMPATIBLE"):
    os.environ.pop(variable, None)


def pytest_configure(config: pytest.Config) -> None:
    """Hypothesis draws the same examples every time, others with `-m population`; none fails because it took long."""
    settings.register_profile(
        "share", derandomize=not wants_populations(config), deadline=None, suppress_health_check=[HealthCheck.too_slow]
    )
    settings.load_profile("share")


def wants_populations(config: pytest.Config) -> bool:
    return "population" in config.getoption("markexpr")


@pytest.fixture(autouse=True, scope="session")
def no_lines_by_the_clock():
    """Of long work, every 10 s: a loaded machine would print some where a test expects nothing; what prints them has its own tests."""
    from gainroom.cli import progress

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(progress, "EVERY", 1e9)
        yield


@pytest.fixture(scope="session")
def body():
    """The biped that ships with gainroom."""
    from robot_truths import biped

    return biped()


@pytest.fixture(scope="module")
def chromium():
    """A browser without a window."""
    from app_pages import a_browser

    with a_browser() as found:
        yield found


@pytest.fixture
def browser(chromium):
    """The same for one test of the interactive page: what it opened is closed behind it, and takes no time from the next."""
    yield chromium
    for context in chromium.contexts:
        context.close()


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """The page of the paper's Fig. 9, at work."""
    from app_pages import serving
    from test_cli import EXAMPLES

    file = tmp_path_factory.mktemp("app") / "fig9.yaml"
    file.write_text(EXAMPLES["fig9"], "utf-8")
    with serving(file) as found:
        yield found


def pytest_collection_finish() -> None:
    """Thousands of collected tests stay as they are: Python need not look through them for garbage again and again."""
    gc.collect()
    gc.freeze()


SHARES = 30
"""Into as many the slow tests are divided."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--share", type=int, metavar="K", help=f"of the tests that are marked slow run share K modulo {SHARES} alone")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Populations run where `-m` names them; slow tests first, so that no process is left with one of them alone at the end."""
    if wants_populations(config):
        return
    share = config.getoption("share")
    slow, quick, left = [], [], []
    for item in items:
        if item.get_closest_marker("population"):
            item.add_marker(pytest.mark.skip(reason="runs with -m population"))
        is_slow = item.get_closest_marker("slow") is not None
        of_another = is_slow and share is not None and (crc32(item.nodeid.encode()) - share) % SHARES != 0
        (left if of_another else slow if is_slow else quick).append(item)
    if left:
        config.hook.pytest_deselected(items=left)
    items[:] = slow + quick
