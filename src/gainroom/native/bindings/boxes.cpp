#include "gainroom/box_loop.hpp"

#include "arrays.hpp"

using gainroom::BoxLoop;
using gainroom::Complex;
using gainroom::kQuantities;
// Sectors of boxes low to high (n, p): their four bounds (4, n), centers (1, n), scores (n, p).
static nb::tuple at(const BoxLoop& loop, Matrix low, Matrix high, bool scaled) {
    const std::size_t count = low.shape(0), width = low.shape(1);
    require(width == std::size_t(loop.width()) && has_shape(high, count, width), "low and high must both be (n, p), p as columns say");
    std::vector<double> bounds(4 * count), scores(count * width);
    std::vector<Complex> centers(count);
    {
        nb::gil_scoped_release release;
        for (std::size_t k = 0; k < count; k++) {
            const gainroom::Sector found = loop.at(low.data() + k * width, high.data() + k * width, scaled);
            const double ends[] = {found.log_low, found.log_high, found.phase_low, found.phase_high};
            for (std::size_t i = 0; i < 4; i++) bounds[i * count + k] = ends[i];
            centers[k] = found.center;
            std::copy(found.score, found.score + width, scores.begin() + std::ptrdiff_t(k * width));
        }
    }
    return nb::make_tuple(owned(bounds.data(), 4, count), owned(centers.data(), 1, count), owned(scores.data(), count, width));
}

void bind_boxes(nb::module_& m) {
    m.attr("MOST_ALIASES") = gainroom::kMostAliases;
    nb::class_<BoxLoop>(m, "BoxLoop")
        .def("__init__",
             [](BoxLoop* self, Vector values, Integers columns, bool motor_side, Roots current_poles, double current_gain, Roots zeros,
                Roots poles, double gain, double control_delay, double sample_time, int aliases, double rest) {
                 require(values.size() == kQuantities + 2, "values must have the shape (7,): five quantities, friction of motor and link");
                 require(columns.size() == kQuantities, "columns must have the shape (5,)");
                 require(aliases >= 0 && aliases <= gainroom::kMostAliases, "aliases must be from 0 to MOST_ALIASES");
                 const std::int64_t most = *std::max_element(columns.data(), columns.data() + kQuantities);
                 bool taken[gainroom::kBoxParameters] = {};
                 for (std::size_t k = 0; k < kQuantities; k++) {
                     const std::int64_t column = columns(k);
                     require(column >= 0 && column < gainroom::kBoxParameters && !(column > 0 && taken[column]),
                             "columns must be different ones from 0 to 5, 0 for what is known");
                     taken[column] = true;
                 }
                 for (std::int64_t column = 1; column <= most; column++) require(taken[column], "columns must be numbered from 0 on");
                 new (self) BoxLoop{};
                 std::copy(values.data(), values.data() + kQuantities, self->values);
                 std::copy(columns.data(), columns.data() + kQuantities, self->columns);
                 self->motor_viscous = values(kQuantities);
                 self->link_viscous = values(kQuantities + 1);
                 self->motor_side = motor_side;
                 self->sample_time = sample_time;
                 self->currents = {{}, {current_poles.data(), current_poles.data() + current_poles.size()}, current_gain};
                 self->control = factors(zeros, poles, gain);
                 self->control_delay = control_delay;
                 self->aliases = aliases;
                 self->rest = rest;
             },
             nb::arg("values"), nb::arg("columns"), nb::arg("motor_side"), nb::arg("current_poles"), nb::arg("current_gain"),
             nb::arg("zeros"), nb::arg("poles"), nb::arg("gain"), nb::arg("control_delay"), nb::arg("sample_time"), nb::arg("aliases"),
             nb::arg("rest"))
        .def("at", &at, nb::arg("low"), nb::arg("high"), nb::arg("scaled"));
}
