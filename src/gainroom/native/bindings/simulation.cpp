#include "arrays.hpp"
#include "gainroom/recursion.hpp"
#include "gainroom/testbed.hpp"

using gainroom::Body;
using gainroom::Control;
using gainroom::FrictionLaw;
using gainroom::Gravity;
using gainroom::Hardware;
using gainroom::kSides;

static std::vector<double> copied(const Vector& array) { return {array.data(), array.data() + array.shape(0)}; }
static std::vector<double> copied(const Matrix& array) { return {array.data(), array.data() + array.size()}; }

static std::array<std::vector<double>, kSides> sides(const Matrix& array, std::size_t columns, const char* message) {
    require(has_shape(array, kSides, columns), message);
    const double* first = array.data();
    return {std::vector<double>(first, first + columns), std::vector<double>(first + columns, first + 2 * columns)};
}

static nb::object stacked(const std::array<std::vector<double>, kSides>& rows) {
    std::vector<double> both = rows[0];
    both.insert(both.end(), rows[1].begin(), rows[1].end());
    return owned(both.data(), kSides, rows[0].size());
}

static std::array<double, 2> pair(const Vector& array, const char* message) {
    require(array.shape(0) == 2, message);
    return {array(0), array(1)};
}

static gainroom::Laws laws(const Matrix& array) {
    require(has_shape(array, kSides, 5), "laws have the shape (2, 5)");
    gainroom::Laws found;
    for (int side = 0; side < kSides; side++)
        found[side] = {array(side, 0), array(side, 1), array(side, 2), array(side, 3), array(side, 4)};
    return found;
}

static Gravity gravity(const Vector& array) {
    const auto [moment, hanging_at] = pair(array, "gravity has the shape (2,)");
    return {moment, hanging_at};
}

static Body body(const Matrix& system, const Matrix& positions, const Matrix& rates, const Matrix& entries, const Vector& current,
                 bool ideal, std::size_t coordinates) {
    const std::size_t size = current.shape(0), width = size + gainroom::kTorques;
    require(has_shape(system, width, width), "system has the shape (m + 3, m + 3), current (m,)");
    require(coordinates <= size / 2, "a body of m states has at most m/2 coordinates");
    return {copied(system),
            sides(positions, size, "positions have the shape (2, m)"),
            sides(rates, size, "rates have the shape (2, m)"),
            sides(entries, size, "entries have the shape (2, m)"),
            copied(current),
            ideal,
            coordinates};
}

static Control control(const Matrix& a, const Matrix& b, const Vector& c, const Vector& d, int side, std::optional<int> velocity,
                       std::optional<Vector> torque) {
    const std::size_t size = c.shape(0), signals = torque ? 3 : 2;
    require(has_shape(a, size, size) && has_shape(b, size, signals) && d.shape(0) == signals,
            "a, b, c, d have the shapes (r, r), (r, e), (r,), (e,) with e = 2, or 3 with a torque");
    for (const int each : {side, velocity.value_or(side)})
        require(each == gainroom::kMotor || each == gainroom::kLink, "side is 0, the motor, or 1, the link");
    return {copied(a), copied(b), copied(c), copied(d), side, velocity.value_or(side), torque ? copied(*torque) : std::vector<double>()};
}

static Hardware hardware(double tick, std::int64_t cells, const Matrix& friction, const Vector& weight, double torque_limit,
                         const Vector& resolution, double position_limit) {
    require(cells >= 1, "a tick has at least one cell");
    return {tick, cells, laws(friction), gravity(weight), torque_limit, pair(resolution, "resolution has the shape (2,)"), position_limit};
}

// A type of its own: pairs become tuples in Python.
struct SecondPath : std::pair<gainroom::Path, gainroom::Delay> {
    using pair::pair;
};

static SecondPath second_path(const Control& control, std::int64_t every, std::int64_t whole, double fraction) {
    require(every >= 1 && every <= 1 << 20, "every is from 1 to 2^20 ticks");
    require(whole >= 0 && whole <= 1 << 24, "whole is from 0 to 2^24 ticks");
    return {gainroom::Path{control, every, whole + 1}, gainroom::Delay{whole, fraction}};
}

static gainroom::Testbed testbed(const Body& body, const Control& control, const Hardware& hardware, const Vector& state,
                                 std::int64_t longest, std::int64_t every, const std::optional<SecondPath>& second) {
    require(state.shape(0) == body.states(), "state has the shape (m,)");
    for (const Control* each : {&control, second ? &second->first.control : &control})
        require(each->torque.empty() || each->torque.size() == body.states(), "torque has the shape (m,)");
    require(longest >= 0 && longest <= 1 << 24, "longest is from 0 to 2^24 ticks");
    require(every >= 1 && every <= 1 << 20, "every is from 1 to 2^20 ticks");
    return {body, gainroom::Path{control, every, longest}, second, hardware, copied(state)};
}

static nb::object advance(gainroom::Testbed& bed, const Matrix& given, const Integers& whole, const Vector& fraction,
                          std::optional<Vector> torque_noise) {
    const std::size_t count = given.shape(0);
    static_assert(sizeof(gainroom::TickInputs) == 7 * sizeof(double) && sizeof(gainroom::TickRow) == 7 * sizeof(double));
    require(given.shape(1) == 7, "given has the shape (k, 7)");
    require(whole.shape(0) == count && fraction.shape(0) == count, "whole and fraction have the shape (k,)");
    require(!torque_noise || torque_noise->shape(0) == count, "torque_noise has the shape (k,)");
    for (std::size_t k = 0; k < count; k++) require(whole(k) >= 0 && whole(k) <= bed.longest(), "whole is from 0 to longest");
    std::vector<gainroom::TickRow> rows(count);
    std::size_t made = 0;
    {
        nb::gil_scoped_release release;
        const auto* inputs = reinterpret_cast<const gainroom::TickInputs*>(given.data());
        const double* noise = torque_noise ? torque_noise->data() : nullptr;
        while (made < count && bed.step(inputs[made], noise ? noise[made] : 0.0, {whole(made), fraction(made)}, rows[made])) made++;
    }
    return owned(reinterpret_cast<const double*>(rows.data()), made, 7);
}

static void substep(const Body& body, const Hardware& hardware, const Array<double, 1>& state, const Array<double, 1>& bent, double width,
                    const Vector& torques) {
    const std::size_t entries = body.width() * body.width();
    require(state.shape(0) == body.states() && bent.shape(0) == kSides, "state and bent have the shapes (m,) and (2,)");
    require(torques.shape(0) == gainroom::kTorques, "torques have the shape (3,)");
    std::vector<double> transition(entries), work(2 * entries);
    nb::gil_scoped_release release;
    gainroom::propagator(body.system.data(), body.width(), width, transition.data(), work.data());
    gainroom::substep(state.data(), bent.data(), transition.data(), width, torques.data(), body, hardware.laws, hardware.gravity,
                      work.data());
}

static nb::object exponential(const Matrix& matrix) {
    const std::size_t size = matrix.shape(0);
    require(matrix.shape(1) == size, "matrix has the shape (n, n)");
    std::vector<double> found(size * size), work(3 * size * size + size);
    gainroom::exponential(matrix.data(), size, found.data(), work.data());
    return owned(found.data(), size, size);
}

static std::size_t recur(const Matrix& transposed, const Matrix& forcing, const Array<double, 2>& states, double limit) {
    const std::size_t size = transposed.shape(0), steps = forcing.shape(0);
    require(transposed.shape(1) == size && forcing.shape(1) == size, "transposed and forcing have the shapes (m, m) and (k, m)");
    require(states.shape(0) == steps + 1 && states.shape(1) == size, "states have the shape (k + 1, m)");
    nb::gil_scoped_release release;
    return gainroom::recur(transposed.data(), size, forcing.data(), steps, states.data(), limit);
}

static std::size_t recur_late(const Matrix& transposed, const Matrix& forcing, const Matrix& rows, const Matrix& before,
                              const Matrix& after, const Integers& whole, const Vector& part, const Array<double, 2>& states) {
    const std::size_t size = transposed.shape(0), steps = forcing.shape(0), count = rows.shape(0);
    require(transposed.shape(1) == size && forcing.shape(1) == size, "transposed and forcing have the shapes (m, m) and (k, m)");
    require(states.shape(0) == steps + 1 && states.shape(1) == size, "states have the shape (k + 1, m)");
    for (const Matrix* each : {&rows, &before, &after})
        require(each->shape(0) == count && each->shape(1) == size, "rows, before and after have the shape (n, m)");
    require(whole.shape(0) == count && part.shape(0) == count, "whole and part have the shape (n,)");
    for (std::size_t j = 0; j < count; j++) require(whole.data()[j] >= 1, "an output comes back at least one step late");
    std::vector<double> sent((steps + 1) * count);
    const gainroom::LateOutputs late{count, rows.data(), before.data(), after.data(), whole.data(), part.data(), sent.data()};
    nb::gil_scoped_release release;
    return gainroom::recur_late(transposed.data(), size, forcing.data(), late, steps, states.data());
}

void bind_simulation(nb::module_& m) {
    nb::class_<Body>(m, "Body")
        .def(nb::new_(&body), nb::arg("system"), nb::arg("positions"), nb::arg("rates"), nb::arg("entries"), nb::arg("current"),
             nb::arg("ideal"), nb::arg("coordinates"))
        .def_prop_ro("positions", [](const Body& self) { return stacked(self.positions); })
        .def_prop_ro("rates", [](const Body& self) { return stacked(self.rates); })
        .def_ro("coordinates", &Body::coordinates);
    nb::class_<Control>(m, "Control")
        .def(nb::new_(&control), nb::arg("a"), nb::arg("b"), nb::arg("c"), nb::arg("d"), nb::arg("side"),
             nb::arg("velocity") = nb::none(), nb::arg("torque") = nb::none());
    nb::class_<Hardware>(m, "Hardware")
        .def(nb::new_(&hardware), nb::arg("tick"), nb::arg("cells"), nb::arg("laws"), nb::arg("gravity"), nb::arg("torque_limit"),
             nb::arg("resolution"), nb::arg("position_limit"));
    nb::class_<SecondPath>(m, "SecondPath")
        .def(nb::new_(&second_path), nb::arg("control"), nb::arg("every"), nb::arg("whole"), nb::arg("fraction"));
    nb::class_<gainroom::Testbed>(m, "Testbed")
        .def(nb::new_(&testbed), nb::arg("body"), nb::arg("control"), nb::arg("hardware"), nb::arg("state"), nb::arg("longest"),
             nb::arg("every") = 1, nb::arg("second") = nb::none())
        .def("advance", &advance, nb::arg("given"), nb::arg("whole"), nb::arg("fraction"), nb::arg("torque_noise") = nb::none());
    m.def("substep", &substep, nb::arg("body"), nb::arg("hardware"), nb::arg("state").noconvert(), nb::arg("bent").noconvert(),
          nb::arg("width"), nb::arg("torques"));
    m.def("exponential", &exponential, nb::arg("matrix"));
    m.def("recur", &recur, nb::arg("transposed"), nb::arg("forcing"), nb::arg("states").noconvert(), nb::arg("limit"));
    m.def("recur_late", &recur_late, nb::arg("transposed"), nb::arg("forcing"), nb::arg("rows"), nb::arg("before"), nb::arg("after"),
          nb::arg("whole"), nb::arg("part"), nb::arg("states").noconvert());
}
