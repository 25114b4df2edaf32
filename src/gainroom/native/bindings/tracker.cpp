#include "gainroom/posture_tracker.hpp"
#include "gainroom/settling.hpp"

#include <chrono>
#include <mutex>
#include <optional>

#include "trees.hpp"

using gainroom::JointData;
using Strided = nb::ndarray<const double, nb::ndim<2>, nb::device::cpu>;

// A tracker with space for the matrices of its ticks, which come in any order of entries. Threads that use it wait for each other.
class GainTracker {
    // What `work` gives, while no other thread uses this tracker and Python's other threads go on.
    template <class Work>
    auto alone(Work work) const {
        nb::gil_scoped_release release;
        const std::lock_guard<std::mutex> lock(busy_);
        return work();
    }

public:
    GainTracker(const Matrix& joints, double sample_time, std::size_t velocities, std::size_t rows, std::size_t contacts, double slices,
                double urgent)
        : joints_(read(joints, velocities)), robot_(joints_.data(), joints_.size(), sample_time, velocities, rows, contacts,
                                                    settings(slices, urgent)),
          mass_(velocities * velocities), rows_(rows * velocities) {}

    // Of tasks of `sizes` directions each with K'p and K'v `gains` (2, m).
    GainTracker(const Matrix& joints, double sample_time, std::size_t velocities, std::size_t rows, std::size_t contacts,
                const std::vector<std::size_t>& sizes, const Matrix& gains, bool rotors, double movable)
        : joints_(read(joints, velocities)), robot_(joints_.data(), joints_.size(), sample_time, velocities, rows, contacts,
                                                    stack(sizes, gains, rotors, movable)),
          mass_(velocities * velocities), rows_(rows * velocities), tasks_(robot_.directions() * velocities) {}

    // `mass` (N, N), `jacobians`: contact Jacobians one below the other, `tasks` those of tasks; a negative contact: an unknown one.
    nb::tuple update(const Strided& mass, const std::vector<Strided>& jacobians, std::int64_t contact, const std::vector<Strided>& tasks) {
        return answer(alone([&] {
            const std::size_t count = copied(mass, jacobians, tasks);
            return robot_.update(mass_.data(), rows_.data(), count, std::size_t(contact), tasks_.data());
        }));
    }

    // The gain that such ticks, all the same, lead to, and whether it is `gain`.
    std::pair<bool, double> settle(const Strided& mass, const std::vector<Strided>& jacobians, std::int64_t contact,
                                   const std::vector<Strided>& tasks, double gain) {
        return alone([&] {
            const std::size_t count = copied(mass, jacobians, tasks);
            gainroom::Limit found;
            const auto tick = [&, k = 0]() mutable {
                if (++k % 1000 == 0) stop_at_signals();
                return robot_.update(mass_.data(), rows_.data(), count, std::size_t(contact), tasks_.data());
            };
            const bool settled = gainroom::settles(tick, gain, found);
            return std::pair(settled, found.gain);
        });
    }

    // From now on update_posture: `contacts` with frames (c, 13) and held (c, 6) each; `switches`: those that are kept ready; tasks (k, 14).
    void set_body(const gainroom::RigidTree& tree, const std::vector<std::pair<Matrix, Matrix>>& contacts,
                  const std::vector<std::size_t>& switches, const Matrix& tasks) {
        require(tree.velocities() == robot_.links().velocities() && tree.joints() == joints_.size(), "the tree has N velocities, n joints");
        require(contacts.size() == tracker().contacts(), "there are as many contacts as before");
        std::vector<std::vector<gainroom::HeldFrame>> states;
        for (const auto& [frames, held] : contacts) {
            states.push_back(held_frames(tree, frames, held));
            std::size_t rows = 0;
            for (const auto& one : states.back()) rows += one.rows();
            require(rows <= robot_.links().most_rows(), "no contact holds more than `rows` directions");
        }
        for (const std::size_t one : switches) require(one < contacts.size(), "switches are contacts");
        const std::vector<gainroom::TaskReading> readings = task_readings(tree, tasks);
        std::size_t directions = 0;
        for (const auto& one : readings) directions += one.directions(tree);
        require(directions == robot_.directions(), "tasks have m directions");
        posture_.emplace(robot_, tree, states, switches, readings);
    }

    nb::tuple update_posture(const Vector& q, std::int64_t contact) {
        require(posture_ && q.shape(0) == posture_->tree().positions(), "there is a body, and q has the shape (nq,)");
        return answer(alone([&] { return posture_->update(q.data(), std::size_t(contact)); }));
    }

    // Ticks at postures q (T, nq) in `contacts` (T), one after the other: of each what update_posture answers, and how long it took [s].
    nb::object replay(const Matrix& q, const std::vector<std::int64_t>& contacts) {
        const std::size_t ticks = q.shape(0), width = q.shape(1);
        require(posture_ && width == posture_->tree().positions() && contacts.size() == ticks, "there is a body, and q has the shape (T, nq)");
        std::vector<double> found(7 * ticks);
        alone([&] {
            double* to = found.data();
            for (std::size_t k = 0; k < ticks; k++) {
                const auto begun = std::chrono::steady_clock::now();
                const gainroom::Limit limit = posture_->update(q.data() + k * width, std::size_t(contacts[k]));
                const double taken = std::chrono::duration<double>(std::chrono::steady_clock::now() - begun).count();
                for (const double value : {limit.gain, limit.frequency, double(limit.certified), double(limit.age), limit.safe_gain,
                                           double(limit.flag), taken})
                    *to++ = value;
            }
        });
        return owned(found.data(), ticks, 7);
    }

    void prepare(const std::vector<Strided>& jacobians, std::int64_t contact) {
        alone([&] {
            const std::size_t count = copy_rows(jacobians, rows_);
            robot_.prepare(rows_.data(), count, std::size_t(contact));
        });
    }

    nb::tuple update_inverse(const Matrix& w, std::int64_t contact) {
        require(has_shape(w, joints_.size(), joints_.size()) && !robot_.directions(), "w has the shape (n, n), and there are no tasks");
        return answer(alone([&] { return tracker().update(w.data(), std::size_t(contact)); }));
    }

    nb::tuple lost(int flag, std::int64_t contact, double limit) {
        return answer(alone([&] { return tracker().lost(static_cast<gainroom::Flag>(flag), std::size_t(contact), limit); }));
    }
    nb::object inverse() const { return owned(robot_.posture(), joints_.size(), joints_.size()); }
    double passive_frequency() const { return tracker().passive_frequency(); }
    double alias_left(const Matrix& w, double omega) const {
        require(has_shape(w, joints_.size(), joints_.size()), "w has the shape (n, n)");
        return robot_.laws().alias_left(w.data(), omega);
    }
    double counted_gain(std::size_t contact) const {
        require(contact < tracker().contacts(), "contact is from 0 to contacts − 1");
        return tracker().counted_gain(contact);
    }

    // Gain, frequency, direction and spread of the crossings followed in one contact state.
    nb::object crossings(std::size_t contact) const {
        require(contact < tracker().contacts(), "contact is from 0 to contacts − 1");
        std::vector<double> values;
        alone([&] {
            for (std::size_t k = 0; k < tracker().crossings(contact); k++) {
                const auto& one = tracker().crossing(contact, k);
                values.insert(values.end(), {one.gain, one.omega, one.rising > 0.0 ? 1.0 : -1.0, one.spread});
            }
        });
        return owned(values.data(), values.size() / 4, 4);
    }

private:
    // One below the other; how many rows.
    std::size_t copy_rows(const std::vector<Strided>& jacobians, std::vector<double>& rows) const {
        const std::size_t size = robot_.links().velocities();
        std::size_t count = 0;
        for (const Strided& one : jacobians) {
            require(one.shape(1) == size && (count + one.shape(0)) * size <= rows.size(), "Jacobians have N columns and fit in `rows`");
            for (std::size_t r = 0; r < one.shape(0); r++, count++)
                for (std::size_t j = 0; j < size; j++) rows[count * size + j] = one(r, j);
        }
        return count;
    }

    // Takes what a tick is given into the space for it; the number of contact rows.
    std::size_t copied(const Strided& mass, const std::vector<Strided>& jacobians, const std::vector<Strided>& tasks) {
        const std::size_t size = robot_.links().velocities();
        require(mass.shape(0) == size && mass.shape(1) == size, "mass has the shape (N, N)");
        for (std::size_t i = 0; i < size; i++)
            for (std::size_t j = i; j < size; j++) mass_[i * size + j] = mass(i, j);
        require(copy_rows(tasks, tasks_) == robot_.directions(), "tasks have m rows");
        return copy_rows(jacobians, rows_);
    }

    static void stop_at_signals() {
        nb::gil_scoped_acquire held;
        if (PyErr_CheckSignals()) throw nb::python_error();
    }

    gainroom::Tracker& tracker() { return robot_.tracker(); }
    const gainroom::Tracker& tracker() const { return robot_.tracker(); }
    static std::vector<JointData> read(const Matrix& joints, std::size_t velocities) {
        static_assert(sizeof(JointData) == 10 * sizeof(double));
        require(joints.shape(1) == 10 && joints.shape(0) > 0, "joints have the shape (n, 10)");
        require(joints.shape(0) <= velocities && velocities <= 512, "there are at least as many velocities as joints, and at most 512");
        const auto* first = reinterpret_cast<const JointData*>(joints.data());
        return {first, first + joints.shape(0)};
    }
    static gainroom::TaskStack stack(const std::vector<std::size_t>& sizes, const Matrix& gains, bool rotors, double movable) {
        std::size_t total = 0;
        for (const std::size_t size : sizes) total += size;
        require(has_shape(gains, 2, total) && total > 0 && total <= 512, "gains have the shape (2, m), sizes add up to m, at most 512");
        return {sizes, {gains.data(), gains.data() + total}, {gains.data() + total, gains.data() + 2 * total}, rotors, movable};
    }
    static gainroom::TrackerSettings settings(double slices, double urgent) {
        gainroom::TrackerSettings found;
        found.slices = slices;
        found.urgent = urgent;
        return found;
    }
    static nb::tuple answer(const gainroom::Limit& limit) {
        return nb::make_tuple(limit.gain, limit.frequency, limit.certified, limit.age, limit.safe_gain, static_cast<int>(limit.flag));
    }

    mutable std::mutex busy_;
    std::vector<JointData> joints_;
    gainroom::RobotTracker robot_;
    std::vector<double> mass_, rows_, tasks_;
    std::optional<gainroom::PostureTracker> posture_;
};

static nb::object link_inverse_inertia(const Strided& mass, const Matrix& rows, std::size_t joints) {
    const std::size_t size = mass.shape(0), count = rows.shape(0);
    require(mass.shape(1) == size && rows.shape(1) == size && joints <= size, "mass and rows have the shapes (N, N) and (c, N), n <= N");
    std::vector<double> values(size * size), inverse(joints * joints);
    for (std::size_t i = 0; i < size; i++)
        for (std::size_t j = i; j < size; j++) values[i * size + j] = mass(i, j);
    gainroom::LinkInertia inertia(size, joints, count);
    require(inertia.compute(values.data(), rows.data(), count, inverse.data()), "mass has to be finite and positive definite");
    return owned(inverse.data(), joints, joints);
}

void bind_tracker(nb::module_& m) {
    m.def("link_inverse_inertia", &link_inverse_inertia, nb::arg("mass"), nb::arg("rows"), nb::arg("joints"));
    nb::class_<GainTracker>(m, "GainTracker")
        .def(nb::init<const Matrix&, double, std::size_t, std::size_t, std::size_t, double, double>(), nb::arg("joints"),
             nb::arg("sample_time"), nb::arg("velocities"), nb::arg("rows"), nb::arg("contacts"), nb::arg("slices"), nb::arg("urgent"))
        .def(nb::init<const Matrix&, double, std::size_t, std::size_t, std::size_t, const std::vector<std::size_t>&, const Matrix&, bool, double>(),
             nb::arg("joints"), nb::arg("sample_time"), nb::arg("velocities"), nb::arg("rows"), nb::arg("contacts"), nb::arg("sizes"),
             nb::arg("gains"), nb::arg("rotors"), nb::arg("movable"))
        .def("update", &GainTracker::update, nb::arg("mass"), nb::arg("jacobians"), nb::arg("contact"), nb::arg("tasks") = std::vector<Strided>())
        .def("settle", &GainTracker::settle, nb::arg("mass"), nb::arg("jacobians"), nb::arg("contact"), nb::arg("tasks"), nb::arg("gain"))
        .def("set_body", &GainTracker::set_body, nb::arg("tree"), nb::arg("contacts"), nb::arg("switches"), nb::arg("tasks"))
        .def("update_posture", &GainTracker::update_posture, nb::arg("q"), nb::arg("contact"))
        .def("replay", &GainTracker::replay, nb::arg("q"), nb::arg("contacts"))
        .def("prepare", &GainTracker::prepare, nb::arg("jacobians"), nb::arg("contact"))
        .def("update_inverse", &GainTracker::update_inverse, nb::arg("w"), nb::arg("contact"))
        .def("lost", &GainTracker::lost, nb::arg("flag"), nb::arg("contact"), nb::arg("limit"))
        .def("crossings", &GainTracker::crossings, nb::arg("contact"))
        .def("counted_gain", &GainTracker::counted_gain, nb::arg("contact"))
        .def("alias_left", &GainTracker::alias_left, nb::arg("w"), nb::arg("omega"))
        .def_prop_ro("inverse", &GainTracker::inverse)
        .def_prop_ro("passive_frequency", &GainTracker::passive_frequency);
}
