#include "gainroom/modal_response.hpp"
#include "gainroom/posture_limits.hpp"

#include "arrays.hpp"

using gainroom::Complex;
using ComplexVector = Array<const Complex, 1>;
using ComplexMatrix = Array<const Complex, 2>;
using Counts = Array<const std::int64_t, 2>;

static gainroom::ModalLoop modal_loop(ComplexMatrix rigid, bool twofold, ComplexMatrix shapes, ComplexVector poles, ComplexVector partners,
                                      double bandwidth, double damping_ratio, double fraction, double step, double inexact) {
    const std::size_t size = rigid.shape(0), modes = poles.size();
    if (rigid.shape(1) != size || shapes.shape(0) != modes || (modes > 0 && shapes.shape(1) != size) ||
        (partners.size() > 0 && partners.size() != modes))
        throw nb::value_error("rigid (n, n), shapes (m, n), poles (m,) and partners, as many or none, do not fit");
    gainroom::ModalLoop loop;
    loop.size = size;
    loop.modes = modes;
    loop.twofold = twofold;
    for (std::size_t k = 0; k < size * size; k++) {
        loop.rigid.push_back(rigid.data()[k].real());
        if (twofold) loop.skew.push_back(rigid.data()[k].imag());
    }
    loop.shapes.assign(shapes.data(), shapes.data() + modes * size);
    loop.poles.assign(poles.data(), poles.data() + modes);
    loop.partners.assign(partners.data(), partners.data() + partners.size());
    loop.bandwidth = bandwidth;
    loop.damping_ratio = damping_ratio;
    loop.fraction = fraction;
    loop.step = step;
    loop.inexact = inexact;
    loop.prepare();
    return loop;
}

// Zeros and poles of all laws, each in a row, `counts` (n, 2) of them, gains and delays (n).
static void set_laws(gainroom::ModalLoop& loop, ComplexVector zeros, ComplexVector poles, Counts counts, Vector gains, Vector delays) {
    if (counts.shape(0) != loop.size || counts.shape(1) != 2 || gains.size() != loop.size || delays.size() != loop.size)
        throw nb::value_error("counts (n, 2), gains and delays (n,) do not fit");
    std::size_t totals[2] = {0, 0};
    for (std::size_t k = 0; k < 2 * loop.size; k++) {
        if (counts.data()[k] < 0) throw nb::value_error("counts must be >= 0");
        totals[k % 2] += static_cast<std::size_t>(counts.data()[k]);
    }
    if (totals[0] != zeros.size() || totals[1] != poles.size()) throw nb::value_error("counts do not add up to zeros and poles");
    loop.laws.clear();
    loop.delays.assign(delays.data(), delays.data() + loop.size);
    const Complex *zero = zeros.data(), *pole = poles.data();
    for (std::size_t i = 0; i < loop.size; i++) {
        const Complex *zero_end = zero + counts.data()[2 * i], *pole_end = pole + counts.data()[2 * i + 1];
        loop.laws.push_back({{zero, zero_end}, {pole, pole_end}, gains.data()[i]});
        zero = zero_end;
        pole = pole_end;
    }
    loop.find_alike();
}

static nb::tuple responses(const gainroom::ModalLoop& loop, Vector omega) {
    std::vector<Complex> functions(omega.size() * (loop.modes + 1)), laws(omega.size() * loop.size);
    for (std::size_t r = 0; r < omega.size(); r++) {
        Complex* row = &functions[r * (loop.modes + 1)];
        loop.functions(omega.data()[r], row[0], row + 1);
        for (std::size_t i = 0; i < loop.laws.size(); i++) laws[r * loop.size + i] = loop.inverse_law(i, omega.data()[r]);
    }
    return nb::make_tuple(owned(functions.data(), omega.size(), loop.modes + 1), owned(laws.data(), omega.size(), loop.size));
}

static nb::object mobility(const gainroom::ModalLoop& loop, ComplexVector s) {
    const std::size_t entries = loop.size * loop.size;
    for (std::size_t r = 0; r < s.size(); r++)
        if (!gainroom::ModalResponse::serves(s.data()[r])) throw nb::value_error("every s must be about jω, ω > 0");
    std::vector<Complex> found(s.size() * entries);
    {
        nb::gil_scoped_release release;
        gainroom::ModalResponse response(loop);
        for (std::size_t r = 0; r < s.size(); r++) response.at(s.data()[r], &found[r * entries]);
    }
    return owned(found.data(), s.size(), entries);
}

// What interpolation between each two ω of `omega` may miss at most: f₀ and f_k (k − 1, 1 + m), d (k − 1, n).
static nb::tuple bends(const gainroom::ModalLoop& loop, Vector omega) {
    const std::size_t cells = omega.size() > 0 ? omega.size() - 1 : 0;
    std::vector<double> functions(cells * (loop.modes + 1)), laws(cells * loop.laws.size());
    for (std::size_t r = 0; r < cells; r++) {
        const gainroom::Cell cell(omega.data()[r], omega.data()[r + 1], loop.step, loop.inexact);
        loop.bends(cell, functions[r * (loop.modes + 1)], &functions[r * (loop.modes + 1) + 1]);
        for (std::size_t i = 0; i < loop.laws.size(); i++)
            laws[r * loop.laws.size() + i] = loop.inverse_law_bend(
                i, cell, std::max(gainroom::ModalLoop::inverse_law_size(loop.inverse_law(i, cell.a), cell.a, loop.step),
                                  gainroom::ModalLoop::inverse_law_size(loop.inverse_law(i, cell.b), cell.b, loop.step)));
    }
    return nb::make_tuple(owned(functions.data(), cells, loop.modes + 1), owned(laws.data(), cells, loop.laws.size()));
}

// On the way of factors from `start`, 0: from rest, to `stop`: whether it is proved; (k, 3) ω, gain and growth of the crossings found, the
// nearest first; their vectors (k, n); undecided (k, 2). `bases` (k - 1, n, n) or (0, n, n): see CoupledLimit::search. And how far
// arg det F turns on what was decided, arg det(I + L) at the end, the end.
static nb::tuple limit(const gainroom::ModalLoop& loop, Vector grid, double start, double stop, double nudge, double floor, bool passive,
                       bool counting, Array<const Complex, 3> bases) {
    if (loop.laws.size() != loop.size || loop.size == 0) throw nb::value_error("the laws of all joints are needed");
    const bool based = bases.shape(0) > 0;
    if (based && (bases.shape(0) + 1 != grid.size() || bases.shape(1) != loop.size || bases.shape(2) != loop.size))
        throw nb::value_error("bases (k - 1, n, n) and a grid (k,) do not fit");
    gainroom::CoupledLimit found(loop);
    bool proved = false;
    {
        nb::gil_scoped_release release;
        proved = found.search(grid.data(), grid.size(), {start, stop}, nudge, floor, passive, counting, based ? bases.data() : nullptr);
    }
    std::vector<double> places;
    std::vector<Complex> vectors;
    for (const gainroom::Crossing& one : found.crossings) {
        places.insert(places.end(), {one.omega, one.gain, one.growth});
        vectors.insert(vectors.end(), one.vector.begin(), one.vector.end());
    }
    return nb::make_tuple(proved, owned(places.data(), found.crossings.size(), 3), owned(vectors.data(), found.crossings.size(), loop.size),
                          owned(reinterpret_cast<const double*>(found.undecided.data()), found.undecided.size(), 2),
                          nb::make_tuple(found.turned, found.tail, found.end));
}

// (k, 2): the part of [low, high] in which factors up to `gain` may put a root on the boundary.
static nb::object searched(const gainroom::ModalLoop& loop, double low, double high, double gain, bool passive) {
    if (loop.laws.size() != loop.size || loop.size == 0) throw nb::value_error("the laws of all joints are needed");
    const std::vector<gainroom::Interval> found = gainroom::CoupledLimit(loop).searched(low, high, gain, passive);
    return owned(reinterpret_cast<const double*>(found.data()), found.size(), 2);
}

// Whether [low, high] is excluded for factors from `start` to `gain`, in the coordinates of `basis`: n vectors in rows; and how far arg det F
// turns there.
static nb::tuple excluded(const gainroom::ModalLoop& loop, double low, double high, double start, double gain, ComplexMatrix basis,
                          double floor, std::int64_t most, bool counting) {
    if (basis.shape(0) != loop.size || basis.shape(1) != loop.size || loop.laws.size() != loop.size)
        throw nb::value_error("basis (n, n) and the laws of all joints are needed");
    std::vector<gainroom::Interval> left;
    double turned = 0.0;
    {
        nb::gil_scoped_release release;
        gainroom::Exclusion exclusion(loop, start, gain, 0.0, counting, basis.data(), loop.size);
        exclusion.run({{low, high}}, floor, most, left);
        turned = exclusion.turned;
    }
    return nb::make_tuple(left.empty(), turned);
}

// Postures one after the other: proved (k, 1); (k, 3) gain, ω and the joint that moves most.
static nb::tuple posture_limits(gainroom::PostureLimits& limits, Cube rigid, Cube shapes, ComplexMatrix poles, ComplexMatrix partners,
                                Vector inexact) {
    const std::size_t count = rigid.shape(0), n = limits.size(), modes = poles.shape(1);
    if (rigid.shape(1) != n || rigid.shape(2) != n || shapes.shape(0) != count || shapes.shape(1) != modes || shapes.shape(2) != n ||
        poles.shape(0) != count || partners.shape(0) != count || partners.shape(1) != modes || inexact.size() != count)
        throw nb::value_error("rigid (k, n, n), shapes (k, m, n), poles and partners (k, m) and inexact (k,) do not fit");
    std::vector<std::int64_t> proved(count);
    std::vector<double> found(3 * count);
    {
        nb::gil_scoped_release release;
        limits.forget();
        for (std::size_t k = 0; k < count; k++) {
            const gainroom::PostureLimit one = limits.at(rigid.data() + k * n * n, shapes.data() + k * modes * n, poles.data() + k * modes,
                                                         partners.data() + k * modes, modes, inexact.data()[k]);
            proved[k] = one.proved;
            found[3 * k] = one.gain;
            found[3 * k + 1] = one.omega;
            found[3 * k + 2] = double(one.joint);
        }
    }
    return nb::make_tuple(owned(proved.data(), count, 1), owned(found.data(), count, 3));
}

void bind_coupled(nb::module_& m) {
    nb::class_<gainroom::ModalLoop>(m, "ModalLoop")
        .def("__init__",
             [](gainroom::ModalLoop* self, ComplexMatrix rigid, bool twofold, ComplexMatrix shapes, ComplexVector poles,
                ComplexVector partners, double bandwidth, double damping_ratio, double fraction, double step, double inexact) {
                 new (self) gainroom::ModalLoop(modal_loop(rigid, twofold, shapes, poles, partners, bandwidth, damping_ratio, fraction, step, inexact));
             },
             nb::arg("rigid"), nb::arg("twofold"), nb::arg("shapes"), nb::arg("poles"), nb::arg("partners"), nb::arg("bandwidth"),
             nb::arg("damping_ratio"), nb::arg("fraction"), nb::arg("step"), nb::arg("inexact"))
        .def("set_laws", &set_laws, nb::arg("zeros"), nb::arg("poles"), nb::arg("counts"), nb::arg("gains"), nb::arg("delays"))
        .def("responses", &responses, nb::arg("omega"))
        .def("mobility", &mobility, nb::arg("s"))
        .def("bends", &bends, nb::arg("omega"))
        .def("limit", &limit, nb::arg("grid"), nb::arg("start"), nb::arg("stop"), nb::arg("nudge"), nb::arg("floor"), nb::arg("passive"),
             nb::arg("counting"), nb::arg("bases"))
        .def("searched", &searched, nb::arg("low"), nb::arg("high"), nb::arg("gain"), nb::arg("passive"))
        .def("excluded", &excluded, nb::arg("low"), nb::arg("high"), nb::arg("start"), nb::arg("gain"), nb::arg("basis"), nb::arg("floor"),
             nb::arg("most"), nb::arg("counting"));
    nb::class_<gainroom::PostureLimits>(m, "PostureLimits")
        .def("__init__",
             [](gainroom::PostureLimits* self, const gainroom::ModalLoop& loop, double slow, double fast, const std::vector<double>& highest,
                bool passive) {
                 require(loop.laws.size() == loop.size && loop.size > 0, "the laws of all joints are needed");
                 new (self) gainroom::PostureLimits(loop, slow, fast, highest, passive);
             },
             nb::arg("loop"), nb::arg("slow"), nb::arg("fast"), nb::arg("highest"), nb::arg("passive"))
        .def("run", &posture_limits, nb::arg("rigid"), nb::arg("shapes"), nb::arg("poles"), nb::arg("partners"), nb::arg("inexact"));
}
