#include "arrays.hpp"
#include "gainroom/current_loop.hpp"
#include "gainroom/prediction.hpp"

using gainroom::LoopTick;
using gainroom::TorqueSensor;

using Result = Array<double, 1>;

static LoopTick loop_tick(const Matrix& transition, const Vector& full) {
    require(has_shape(transition, 2, 2) && full.shape(0) == 2, "transition and full have the shapes (2, 2) and (2,)");
    return {{{transition(0, 0), transition(0, 1)}, {transition(1, 0), transition(1, 1)}}, {full(0), full(1)}};
}

static void predict_torque(const Vector& command, const Matrix& changes, const Vector& torque, const Array<const bool, 1>& fresh,
                           const Matrix& tick, const Matrix& parts, const Cube& noises, double gain, double offset, double noise,
                           double unknown, const Result& error, const Result& variance) {
    const std::size_t rows = command.shape(0), kinds = changes.shape(1);
    require(torque.shape(0) == rows && changes.shape(0) == rows && fresh.shape(0) == rows, "command, changes, torque, fresh have m rows");
    require(error.shape(0) == rows && variance.shape(0) == rows, "error and variance have the shape (m,)");
    require(has_shape(tick, 3, 3) && has_shape(parts, kinds, 3), "tick and parts have the shapes (3, 3) and (q, 3)");
    require(noises.shape(0) == kinds && noises.shape(1) == 3 && noises.shape(2) == 3, "noises have the shape (q, 3, 3)");
    nb::gil_scoped_release release;
    gainroom::predict_torque({rows, command.data(), changes.data(), torque.data(), fresh.data()}, tick.data(),
                             {kinds, parts.data(), noises.data()}, {gain, offset, noise}, unknown, error.data(), variance.data());
}

static void decode(const Vector& target, const Vector& torque, const Matrix& transition, const Vector& full, const Vector& part,
                   double gain, double offset, double noise, std::int64_t first, std::int64_t last, double change_cost,
                   const Array<std::int64_t, 1>& age) {
    const std::size_t rows = target.shape(0);
    require(torque.shape(0) == rows && age.shape(0) == rows, "target, torque and age have the shape (m,)");
    require(part.shape(0) == 2, "part has the shape (2,)");
    require(0 <= first && first <= last && last - first < 256 && last < std::int64_t{1} << 40, "ages are from 0 to 2^40, and at most 256");
    const LoopTick tick = loop_tick(transition, full);
    nb::gil_scoped_release release;
    gainroom::decode(target.data(), torque.data(), rows, tick, {first, last, {part(0), part(1)}, change_cost}, {gain, offset, noise},
                     age.data());
}

static void predict(const Matrix& a, const Matrix& b, const Matrix& c, const Cube& gains, const Integers& regime, const Matrix& inputs,
                    const Matrix& outputs, const Result& state, const Array<double, 2>& errors) {
    const std::size_t size = a.shape(0), rows = inputs.shape(0), seen = c.shape(0);
    require(a.shape(1) == size && c.shape(1) == size && state.shape(0) == size, "a, c and state have the shapes (n, n), (o, n) and (n,)");
    require(has_shape(b, size, inputs.shape(1)), "b and inputs have the shapes (n, i) and (m, i)");
    require(has_shape(outputs, rows, seen), "outputs have the shape (m, o)");
    require(errors.shape(0) == rows && errors.shape(1) == seen, "errors have the shape (m, o)");
    require(gains.shape(1) == size && gains.shape(2) == seen, "gains have the shape (r, n, o)");
    require(regime.shape(0) == rows, "regime has the shape (m,)");
    const auto regimes = static_cast<std::int64_t>(gains.shape(0));
    for (std::size_t k = 0; k < rows; k++) require(regime(k) >= 0 && regime(k) < regimes, "a regime is from 0 to r − 1");
    nb::gil_scoped_release release;
    gainroom::predict({size, inputs.shape(1), seen, a.data(), b.data(), c.data(), gains.data()}, regime.data(), inputs.data(),
                      outputs.data(), rows, state.data(), errors.data());
}

void bind_identification(nb::module_& m) {
    m.def("predict_torque", &predict_torque, nb::arg("command"), nb::arg("changes"), nb::arg("torque"), nb::arg("fresh"),
          nb::arg("tick"), nb::arg("parts"), nb::arg("noises"), nb::arg("gain"), nb::arg("offset"), nb::arg("noise"), nb::arg("unknown"),
          nb::arg("error").noconvert(), nb::arg("variance").noconvert());
    m.def("decode", &decode, nb::arg("target"), nb::arg("torque"), nb::arg("transition"), nb::arg("full"), nb::arg("part"), nb::arg("gain"),
          nb::arg("offset"), nb::arg("noise"), nb::arg("first"), nb::arg("last"), nb::arg("change_cost"), nb::arg("age").noconvert());
    m.def("predict", &predict, nb::arg("a"), nb::arg("b"), nb::arg("c"), nb::arg("gains"), nb::arg("regime"), nb::arg("inputs"),
          nb::arg("outputs"), nb::arg("state").noconvert(), nb::arg("errors").noconvert());
}
