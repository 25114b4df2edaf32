// Random trees of links, postures, contacts and tasks on them, and matrices of any rank; among them NaN, infinite, zero and huge numbers.
#include <cstdio>
#include <limits>
#include <random>

#include "gainroom/posture_estimate.hpp"
#include "gainroom/posture_tracker.hpp"
#include "gainroom/task_motion.hpp"

using namespace gainroom;

static std::mt19937 generator(20);

static double drawn(bool hostile) {
    using Limits = std::numeric_limits<double>;
    static const double odd[] = {0.0, -0.0, 1e300, -1e-300, Limits::infinity(), Limits::quiet_NaN()};
    if (hostile && generator() % 20 == 0) return odd[generator() % 6];
    return std::normal_distribution<double>()(generator);
}

static Triple triple(bool hostile) { return {drawn(hostile), drawn(hostile), drawn(hostile)}; }

static Pose pose(bool hostile) {
    const Turned turned = exponential(triple(hostile), triple(hostile));
    return {rotation(turned.rotation), turned.origin};
}

static Real matrix(std::size_t rows, std::size_t columns, bool hostile) {
    Real found(rows, columns);
    for (double& entry : found.entries) entry = drawn(hostile);
    return found;
}

// The residual of a Newton step on a tree of up to 12 joints.
static bool tree(bool hostile) {
    const std::size_t count = generator() % 13;
    std::vector<TreeJoint> joints;
    std::vector<Mass> masses{{1.0, triple(hostile)}};
    for (std::size_t k = 0; k < count; k++) {
        const std::size_t kind = generator() % 3;
        joints.push_back({generator() % (k + 1), pose(hostile), {0, 0, 1}, kind == 1, kind == 2});
        masses.push_back({std::fabs(drawn(hostile)), triple(hostile), {triple(hostile), triple(hostile), triple(hostile)}});
    }
    RigidTree body(generator() % 2 == 0, pose(hostile), joints, masses, {0, 0, -9.81});
    std::vector<double> q(body.positions()), angles(count), v(body.velocities()), back, counted(6 * count), g(body.velocities());
    for (double& one : q) one = drawn(hostile);
    for (double& one : v) one = drawn(hostile);
    const std::array<bool, kTwist> all{true, true, true, true, true, true}, point{true, true, true, false, false, false};
    PostureEstimate estimate(body, {{{generator() % (count + 1), pose(hostile)}, all}, {{0, pose(hostile)}, point}}, q.data());
    back.assign(estimate.rows() * body.velocities(), drawn(hostile));
    estimate.renew(back.data(), generator() % 2 == 0 && body.base_velocities() ? counted.data() : nullptr);
    body.get(q.data(), angles.data());
    for (int tick = 0; tick < 5; tick++) estimate.update(angles.data());
    const Frame frame{count, pose(hostile)};
    TaskValues values(body, {{Reading::center, frame}, {Reading::posture, frame}, {Reading::orientation, frame}}, q.data());
    std::vector<double> found(values.size());
    values.read(estimate.posture().data(), found.data());
    body.place(q.data());
    body.weight(g.data());
    TreeDynamics dynamics(body);
    std::vector<double> mass(v.size() * v.size()), rows((6 + 3 + 3 + count) * v.size());
    dynamics.place(q.data());
    dynamics.mass_matrix(mass.data());
    double* end = dynamics.write(HeldFrame{frame, all}, rows.data());
    for (const Reading kind : {Reading::center, Reading::posture, Reading::orientation}) end = dynamics.write(TaskReading{kind, frame}, end);
    double sum = end == rows.data() + rows.size() ? 0.0 : std::numeric_limits<double>::quiet_NaN();
    for (const double one : found) sum += one;
    return std::isfinite(sum);
}

// A A⁺ A = A for matrices of any rank.
static bool inverse(bool hostile) {
    const std::size_t rows = generator() % 9, columns = generator() % 9, rank = generator() % 9;
    const Real a = product(matrix(rows, rank, hostile), matrix(rank, columns, hostile));
    RowSpace space(a, 1e-9);
    const Real again = product(product_turned(a, space.inverse_turned()), a);
    double worst = 0.0, most = 0.0;
    for (std::size_t k = 0; k < a.entries.size(); k++) {
        worst = std::fmax(worst, std::fabs(again.entries[k] - a.entries[k]));
        most = std::fmax(most, std::fabs(a.entries[k]));
    }
    return hostile || (space.rank() == std::min({rows, columns, rank}) && worst <= 1e-9 * most);
}

static void tasks(bool hostile) {
    const std::size_t size = 1 + generator() % 12, joints = 1 + generator() % size, held = generator() % 9, first = generator() % 4;
    const Real root = matrix(size, size, hostile), mass = product_turned(root, root), rows = matrix(held, size, hostile);
    LinkInertia links(size, joints, held);
    std::vector<double> inverse(joints * joints);
    if (!links.compute(mass.entries.data(), rows.entries.data(), held, inverse.data())) return;
    TaskMotion motion(size, joints, {first, 3}, 1e-6);
    motion.compute(links, matrix(first + 3, size, hostile).entries.data());
}

// Ticks of a tracker at postures of which some are none: what is certified is a number, as is the safe gain, and unknown contacts are flagged.
static bool ticks(bool hostile) {
    const std::size_t count = 1 + generator() % 6;
    std::vector<TreeJoint> joints;
    std::vector<Mass> masses{{1.0, triple(false), {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}}};
    for (std::size_t k = 0; k < count; k++) {
        joints.push_back({generator() % (k + 1), pose(false), {0, 0, 1}, k % 3 == 1, k % 3 == 2});
        masses.push_back({1.0, triple(false), {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}});
    }
    const RigidTree body(generator() % 2 == 0, pose(false), joints, masses, {0, 0, -9.81});
    const std::vector<JointData> data(count, {0.3, 0.1, 0.0, 8e3, 2.0, 4000.0, 0.9, 2e-3, 600.0, 30.0});
    const HeldFrame foot{{count, pose(false)}, {true, true, true, true, true, true}};
    RobotTracker robot(data.data(), count, generator() % 2 ? 5e-4 : 0.0, body.velocities(), 6, 2);
    PostureTracker tracker(robot, body, {{}, {foot}}, {0, 1}, {});
    std::vector<double> q(body.positions()), angles(count);
    bool right = true;
    for (int tick = 0; tick < 30; tick++) {
        for (double& one : angles) one += 0.01 * drawn(false);
        if (body.base_velocities()) q[6] = 1.0;
        body.put(angles.data(), q.data());
        std::vector<double> given = q;
        if (hostile) given[generator() % given.size()] = drawn(true);
        const std::size_t contact = tick % 10 == 9 ? 2 : std::size_t(tick / 15);
        const Limit found = tracker.update(given.data(), contact);
        right = right && (contact < 2 || found.flag == Flag::bad_contact) && !(found.certified && !(found.gain > 0.0));
        right = right && found.safe_gain >= 0.0;
    }
    return right;
}

int main() {
    int ordinary = 0, wrong = 0;
    for (int k = 0; k < 60; k++) wrong += !ticks(k % 2 == 0);
    for (int k = 0; k < 2000; k++) {
        ordinary += tree(k % 2 == 0);
        wrong += !inverse(k % 2 == 0);
        tasks(k % 2 == 0);
    }
    std::printf("%d %d\n", ordinary, wrong);
}
