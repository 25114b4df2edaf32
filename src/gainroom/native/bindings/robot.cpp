#include <cmath>

#include "gainroom/posture_estimate.hpp"
#include "gainroom/task_motion.hpp"
#include "gainroom/tree_dynamics.hpp"
#include "trees.hpp"

using gainroom::Frame;
using gainroom::Pose;
using gainroom::PostureEstimate;
using gainroom::Real;
using gainroom::RigidTree;
using gainroom::TaskValues;
using gainroom::Triple;

static nb::object vector(const std::vector<double>& values) {
    double* copy = new double[values.size() + 1];
    std::copy(values.begin(), values.end(), copy);
    nb::capsule owner(copy, [](void* pointer) noexcept { delete[] static_cast<double*>(pointer); });
    return nb::cast(nb::ndarray<nb::numpy, double, nb::ndim<1>>(copy, {values.size()}, owner));
}

static RigidTree tree(bool floating, const Vector& root, const Matrix& joints, const Matrix& masses, const Vector& gravity) {
    const std::size_t count = joints.shape(0);
    require(joints.shape(1) == kPlace + 5 && has_shape(masses, count + 1, 13), "joints and masses have the shapes (n, 17) and (n + 1, 13)");
    require(root.shape(0) == kPlace && gravity.shape(0) == 3, "root and gravity have the shapes (12,) and (3,)");
    std::vector<gainroom::TreeJoint> tree_joints;
    std::vector<gainroom::Mass> links;
    for (std::size_t k = 0; k < count; k++) {
        const double* row = joints.data() + k * (kPlace + 5);
        const std::size_t kind = index(row[kPlace + 4], 3, "a joint's kind is 0, 1 or 2");
        const std::size_t parent = index(row[0], k + 1, "a joint's parent comes before it");
        tree_joints.push_back({parent, pose(row + 1), triple(row + kPlace + 1), kind == 1, kind == 2});
    }
    for (std::size_t k = 0; k <= count; k++) {
        const double* row = masses.data() + 13 * k;
        links.push_back({row[0], triple(row + 1), {triple(row + 4), triple(row + 7), triple(row + 10)}});
    }
    return {floating, pose(root.data()), std::move(tree_joints), std::move(links), triple(gravity.data())};
}

static std::vector<double> weight(RigidTree& tree, const Vector& q) {
    std::vector<double> found(tree.velocities());
    tree.place(posture(tree, q));
    tree.weight(found.data());
    return found;
}

// Mass matrix, Jacobians of held frames and of tasks, one below the other.
static nb::tuple dynamics(const RigidTree& tree, const Vector& q, const Matrix& frames, const Matrix& held, const Matrix& tasks) {
    const std::size_t size = tree.velocities();
    gainroom::TreeDynamics body(tree);
    body.place(posture(tree, q));
    const auto contacts = held_frames(tree, frames, held);
    const auto readings = task_readings(tree, tasks);
    std::vector<double> mass(size * size), rows(gainroom::kTwist * contacts.size() * size), more((tree.joints() + 3) * readings.size() * size);
    body.mass_matrix(mass.data());
    for (std::size_t i = 0; i < size; i++)
        for (std::size_t j = 0; j < i; j++) mass[i * size + j] = mass[j * size + i];
    double *end = rows.data(), *last = more.data();
    for (const auto& one : contacts) end = body.write(one, end);
    for (const auto& one : readings) last = body.write(one, last);
    const std::size_t held_rows = std::size_t(end - rows.data()) / size, task_rows = std::size_t(last - more.data()) / size;
    return nb::make_tuple(owned(mass.data(), size, size), owned(rows.data(), held_rows, size), owned(more.data(), task_rows, size));
}

static PostureEstimate estimate(const RigidTree& tree, const Matrix& frames, const Matrix& held, const Vector& start) {
    return {tree, held_frames(tree, frames, held), posture(tree, start)};
}

static void renew(PostureEstimate& self, const Matrix& back, const std::optional<Matrix>& counted) {
    const std::size_t velocities = self.tree().velocities(), base = self.tree().base_velocities();
    require(has_shape(back, velocities, self.rows()), "back has the shape (N, c)");
    require(!counted || has_shape(*counted, base, self.tree().joints()), "counted has the shape (6, n) of a floating base");
    self.renew(back.data(), counted ? counted->data() : nullptr);
}

static nb::object update(PostureEstimate& self, const Vector& joints) {
    require(joints.shape(0) == self.tree().joints(), "joints have the shape (n,)");
    self.update(joints.data());
    return vector(self.posture());
}

static TaskValues values(const RigidTree& tree, const Matrix& tasks, const Vector& start) {
    return {tree, task_readings(tree, tasks), posture(tree, start)};
}

static nb::object task_values(TaskValues& self, const Vector& q) {
    std::vector<double> found(self.size());
    self.read(posture(self.tree(), q), found.data());
    return vector(found);
}

static Real real(const Matrix& array) {
    for (std::size_t k = 0; k < array.size(); k++) require(std::isfinite(array.data()[k]), "matrices are finite");
    return {array.shape(0), array.shape(1), array.data()};
}

static nb::object owned(const Real& matrix) { return owned(matrix.entries.data(), matrix.rows, matrix.columns); }

static nb::object pseudo_inverse(const Matrix& matrix, double share) {
    return owned(transposed(gainroom::RowSpace(real(matrix), share).inverse_turned()));
}

static nb::tuple task_motion(const Matrix& inertia, const Matrix& held, const Matrix& tasks, const std::vector<std::size_t>& sizes,
                             std::size_t joints, double movable) {
    const std::size_t size = inertia.shape(0);
    std::size_t total = 0;
    for (const std::size_t one : sizes) total += one;
    require(inertia.shape(1) == size && held.shape(1) == size, "inertia and held have the shapes (N, N), (c, N)");
    require(tasks.shape(0) == total && tasks.shape(1) == size, "tasks have the shape (m, N), sizes add up to m");
    require(joints > 0 && joints <= size, "there are 1 to N joints");
    gainroom::LinkInertia links(size, joints, held.shape(0));
    gainroom::TaskMotion motion(size, joints, sizes, movable);
    Real inverse(joints, joints), follow;
    require(links.compute(real(inertia).entries.data(), real(held).entries.data(), held.shape(0), inverse.entries.data()),
            "the inertia is not positive definite");
    require(motion.compute(links, real(tasks).entries.data()), "matrices are finite");
    motion.follow(links, follow);
    return nb::make_tuple(owned(follow), owned(motion.torque()), motion.ranks(), size - links.held());
}

void bind_robot(nb::module_& m) {
    nb::class_<RigidTree>(m, "RigidTree")
        .def(nb::new_(&tree), nb::arg("floating"), nb::arg("root"), nb::arg("joints"), nb::arg("masses"), nb::arg("gravity"))
        .def("weight", [](RigidTree& self, const Vector& q) { return vector(weight(self, q)); }, nb::arg("q"))
        .def("dynamics", &dynamics, nb::arg("q"), nb::arg("frames"), nb::arg("held"), nb::arg("tasks"));
    nb::class_<PostureEstimate>(m, "PostureEstimate")
        .def(nb::new_(&estimate), nb::arg("tree"), nb::arg("frames"), nb::arg("held"), nb::arg("start"))
        .def("renew", &renew, nb::arg("back"), nb::arg("counted").none())
        .def("update", &update, nb::arg("joints"));
    nb::class_<TaskValues>(m, "TaskValues")
        .def(nb::new_(&values), nb::arg("tree"), nb::arg("tasks"), nb::arg("start"))
        .def("read", &task_values, nb::arg("q"));
    m.def("pseudo_inverse", &pseudo_inverse, nb::arg("matrix"), nb::arg("share"));
    m.def("task_motion", &task_motion, nb::arg("inertia"), nb::arg("held"), nb::arg("tasks"), nb::arg("sizes"), nb::arg("joints"),
          nb::arg("movable"));
}
