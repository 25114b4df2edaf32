"""Lines of equal dynamic stiffness on the app's gain map, each point against the exact loop's."""

import pytest

import gainroom as gr
from gainroom.app.joint_bench import limits
from gainroom.cli.example import example_texts
from gainroom.files.joint_yaml import load_joint
from gainroom.studies.joint import study_joint


def test_lines_of_equal_stiffness_are_where_the_link_is_that_stiff(tmp_path):
    file = tmp_path / "joint.yaml"
    file.write_text(example_texts()["testbed-sampled"], "utf-8")
    study = study_joint(load_joint(file))
    joint, drive = study.system.source, study.system.drives[0]
    best = study.recommended
    part = limits(study, (2.5 * best.kp, 2.5 * best.kd))
    assert len(part["heights"]) == 3
    seen = 0
    for one in part["heights"]:
        told = float("".join(sign for sign in one["text"].partition("N")[0] if sign in "0123456789."))
        points = [(kp, kd) for kp, kd in zip(*one["line"], strict=True) if kp is not None]
        for kp, kd in points[:: max(1, len(points) // 10)]:
            loop = gr.build_loop(joint, drive, gr.PD(kp, kd), sample_time=study.system.control.sample_time)
            if not gr.is_stable(loop):  # the line of a cell that lies across the edge of the stable gains
                continue
            # straight in a cell of a grid of 1/80 of the map, where the stiffness changes by a few percent, and three digits
            assert gr.dynamic_stiffness(loop).least == pytest.approx(told, rel=0.05)
            seen += 1
    assert seen > 10
