"""Where stability ends, from a count of roots alone, and what its certificate claims: roots outside, none inside."""

import numpy as np
import pytest

from gainroom.analysis.first_crossing import Certificate, End, Family, Rough


@pytest.mark.parametrize(
    ("inside", "outside", "holds"), [(0, 1, True), (0, 4, True), (0, -1, True), (0, 0, False), (1, 2, False), (-1, 1, False)]
)
def test_a_certificate_needs_none_inside_and_some_outside(inside: int, outside: int, holds: bool):
    """−1 stands for unstable, not counted. Where nothing is lost outside either, it is no end."""
    assert Certificate(inside, outside).holds == holds


def family(count, crossings: tuple[float, ...] = ()) -> Family:
    """Of a count of roots by t; crossings as they are believed, exact already."""
    rough = [Rough(at, 5.0, -1 / at + 0j) for at in crossings]
    return Family(
        count=count,
        crossings=lambda: rough,
        polish=lambda group: group,
        closer=lambda omega: None,
        nearest=lambda at: Rough(at, 5.0, -1 / at + 0j),
        mode=lambda one: np.ones(1, dtype=complex),
    )


def ended(one: Family, start: float = 1.0, stop: float = 8.0) -> End:
    found = one.end(start, stop)
    assert found is not None
    return found


def test_an_end_without_a_crossing_is_halved_to_and_counted():
    """Roots leave at 2: nothing but the count knows. What the bracket ends at is counted, as any end is."""
    found = ended(family(lambda t: 0 if t < 2 else 2))
    assert found.at == pytest.approx(2, rel=2e-6)
    assert (found.certificate.inside, found.certificate.outside) == (0, 2)
    assert found.certificate.holds


def test_an_end_of_what_was_never_stable_is_not_certified():
    """A start that holds a root itself: halving ends at the start, and the certificate says that roots are inside."""
    found = ended(family(lambda t: 1))
    assert found.certificate.inside == 1
    assert not found.certificate.holds


def test_a_crossing_behind_the_first_is_not_taken_for_it():
    """At 3 a pair leaves, as its locus shows; at 2 another has left that no sample shows: the end is there, found by halving."""
    found = ended(family(lambda t: 0 if t < 2 else 2 if t < 3 else 4, crossings=(3.0,)))
    assert found.at == pytest.approx(2, rel=2e-6)
    assert (found.certificate.inside, found.certificate.outside) == (0, 2)


def test_a_crossing_at_which_nothing_leaves_is_passed():
    """A locus touches at 3 and turns round: the count outside is 0, and the end is the next one."""
    found = ended(family(lambda t: 0 if t < 5 else 2, crossings=(3.0, 5.0)))
    assert found.at == 5
    assert found.certificate.holds


def test_an_end_downwards_is_found_as_one_upwards():
    found = ended(family(lambda t: 0 if t > 0.25 else 1), stop=1e-6)
    assert found.at == pytest.approx(0.25, rel=1e-5)
    assert found.certificate.holds


def test_no_end_where_all_of_the_way_is_stable():
    assert family(lambda t: 0, crossings=(3.0,)).end(1.0, 8.0) is None
