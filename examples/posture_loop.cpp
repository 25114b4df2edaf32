// The gain limits of gainroom's biped at every tick, from joint angles alone: what Python wrote of the robot, in a controller in C++.
//
// docs/realtime.md, "In a C++ controller", shows how biped.hpp is written, and
//
//     headers=$(python -c 'import gainroom.native; print(gainroom.native.include_dir())')
//     mkdir -p build && c++ -std=c++17 -O2 -I"$headers" -I. examples/posture_loop.cpp -o build/posture_loop && build/posture_loop
//
// On a robot angles are the encoders', in the order of robot.joint_names, and the contact state is its estimator's. The gains that its file has are
// multiplied by `factor`.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <vector>

#include "biped.hpp"

int main() {
    constexpr double period = 1e-3;  // of this loop [s]
    const gainroom::TrackedRobot robot = biped_robot();
    if (robot.sample_time != period) {
        std::fprintf(stderr, "the limits of %s are those of another sample time\n", robot.model);
        return 1;
    }
    gainroom::GainTracker tracker(robot);  // all memory is taken here
    if (!tracker.settle()) {
        std::fprintf(stderr, "%s: in contact state %s the first limit is not that of gain_limit\n", robot.model, tracker.unsettled() ? tracker.unsettled() : "(none)");
        return 1;
    }
    const std::size_t walk[] = {robot.contact("double"), robot.contact("left"), robot.contact("double"), robot.contact("right")};
    std::vector<double> q = robot.posture, stand(robot.joints.size()), angles;
    robot.tree.get(q.data(), stand.data());
    double factor = 0.0;
    for (std::size_t tick = 0; tick < 4000; tick++) {
        const double time = period * double(tick);
        const std::size_t contact = walk[tick / 1000];
        angles = stand;
        for (std::size_t i = 0; i < angles.size(); i++) angles[i] += 0.1 * std::sin(4.0 * time + double(i));
        robot.tree.put(angles.data(), q.data());
        const gainroom::Limit limit = tracker.update(q.data(), contact);
        factor = std::min(1.0, limit.safe_gain / robot.gain_margin);
        if (tick % 500 == 499)
            std::printf("%5.3f s  %-6s  limit %.3f at %.1f Hz  %-13s  factor on the gains %.3f\n", time, robot.contacts[contact].name, limit.gain,
                        limit.frequency / (2 * gainroom::kPi), limit.certified ? "certified" : "not certified", factor);
    }
}
