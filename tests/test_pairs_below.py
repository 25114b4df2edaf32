"""Gain limits where a locus crosses the negative real axis and turns back between samples: a narrow interval of instability below another.

One joint crosses with a wide locus; another one's link resonates beside that crossing, damped by a few 1e-5, and turns it back over the
boundary for a few tenths of a percent of the factor; the last joint crosses a little above, by itself.
"""

import numpy as np
import pytest

import gainroom as gr
from independent.loci.limit import limit_from_loci

NAMES = ("motor_inertia", "motor_viscous", "link_viscous", "stiffness", "damping", "bandwidth", "damping_ratio", "delay", "kp", "kd")

MACHINES = {
    "continuous": (
        None,
        [
            (0.3136264883, 0, 0, 3154.027017, 2.651649703, 2317.333724, 0.9, 8.004976607e-4, 252.2940262, 17.79056935),
            (0.7385241063, 0, 0, 553104.8060, 0.08372907123, 2317.333724, 0.9, 8.004976607e-4, 7.385241063e-5, 7.385241063e-4),
            (0.1448445038, 0, 0, 1456.648259, 1.224631528, 2317.333724, 0.9, 2.962431433e-4, 203.1510847, 14.32524391),
        ],
        [(72.014669362, -2.330641661, 0), (-2.330641661, 0.435456665, 0), (0, 0, 24.286378283)],
    ),
    "2 kHz, drives with different delays": (
        5e-4,
        [
            (0.1579849667, 0, 0, 401.4773786, 0.5966949649, 2573.775800, 0.9, 2.232536171e-3, 168.3025198, 10.31295651),
            (0.2446126346, 0, 0, 48245.20664, 0.1524717339, 2573.775800, 0.9, 2.232536171e-3, 2.446126346e-5, 2.446126346e-4),
            (0.1553225826, 0, 0, 5618.024580, 0.009943950377, 2573.775800, 0.9, 2.232536171e-3, 1.553225826e-5, 1.553225826e-4),
            (0.1827997456, 0, 0, 464.5376343, 0.6904181459, 2573.775800, 0.9, 2.452578924e-3, 177.8039160, 10.89516696),
        ],
        [
            (81.853274979, 0.181313855, 19.350114402, 0),
            (0.181313855, 0.134998349, 0, 0),
            (19.350114402, 0, 28.955056762, 0),
            (0, 0, 0, 0.94765835),
        ],
    ),
    "1 kHz": (
        1e-3,
        [
            (0.3044616429, 0, 0, 581.8331633, 0.8260558596, 1771.355683, 0.9, 5.480417931e-4, 3.860940212, 2.168417119),
            (0.4335786188, 0, 0, 12962.34828, 0.09066612930, 1771.355683, 0.9, 5.480417931e-4, 4.335786188e-5, 4.335786188e-4),
            (8.475366556, 0, 0, 257582.8062, 0.09150214398, 1771.355683, 0.9, 5.480417931e-4, 8.475366556e-4, 8.475366556e-3),
            (0.3367438001, 0, 0, 643.5251041, 0.9136428046, 1771.355683, 0.9, 7.512928942e-4, 3.866065578, 2.171295674),
        ],
        [
            (6.655812768, -10.006820047, -1.829695648, 0),
            (-10.006820047, 25.636773829, 0, 0),
            (-1.829695648, 0, 1.346507632, 0),
            (0, 0, 0, 9.428998925),
        ],
    ),
}


def loop_of(table, inverse, sample_time: float | None, joints: range) -> gr.Loop:
    rows = np.array(table, dtype=float)[joints]
    of = dict(zip(NAMES, rows.T, strict=True))
    inverse = np.array(inverse, dtype=float)[np.ix_(joints, joints)]
    plant = gr.Plant(inverse, of["motor_inertia"], of["stiffness"], of["damping"], of["motor_viscous"])
    return gr.build_loop(plant, [gr.Drive(*row) for row in rows[:, 5:8]], gr.PD(of["kp"], of["kd"]), "motor", sample_time)


@pytest.mark.slow
@pytest.mark.parametrize(
    "limit_of", [gr.gain_limit, limit_from_loci, lambda loop: gr.margins(loop).limit], ids=["proved or not", "from loci", "margins"]
)
@pytest.mark.parametrize("machine", MACHINES)
def test_limit_is_where_stability_is_first_lost(machine: str, limit_of):
    """Stable at all factors below it and unstable just above, by counts of roots and by the rightmost roots themselves.

    The last joint feels no other: the limit is the lesser of its own and of the others'.
    """
    sample_time, table, inverse = MACHINES[machine]
    size = len(table)
    whole = loop_of(table, inverse, sample_time, range(size))
    found = limit_of(whole).gain
    parts = [loop_of(table, inverse, sample_time, joints) for joints in (range(size - 1), range(size - 1, size))]
    assert found == pytest.approx(min(gr.gain_limit(part).gain for part in parts), rel=1e-9)
    # A few 1e-4 beside the limit, where the interval of instability is a few 1e-3 wide.
    assert np.real(gr.rightmost_roots(parts[0].scaled(found * 1.0002)).roots).max() > 0
    assert np.real(gr.rightmost_roots(parts[0].scaled(found * 0.9998)).roots).max() < 0
    for share in np.linspace(0.95, 0.9998, 30):
        assert gr.is_stable(whole.scaled(share * found)), share
