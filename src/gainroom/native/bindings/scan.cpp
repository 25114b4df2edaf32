#include "gainroom/assignment.hpp"
#include "gainroom/scalar_delay_margin.hpp"

#include "arrays.hpp"

using gainroom::Complex;

static nb::tuple scan(Roots zeros, Roots poles, double gain, double delay, double sample_time, bool with_peaks) {
    gainroom::Scan found;
    {
        nb::gil_scoped_release release;
        const gainroom::Response loop(zeros.data(), zeros.size(), poles.data(), poles.size(), gain, delay, sample_time);
        found = gainroom::scan(loop, with_peaks);
    }
    static_assert(sizeof(gainroom::GainCrossing) == 2 * sizeof(double) && sizeof(gainroom::PhaseCrossing) == 3 * sizeof(double));
    return nb::make_tuple(owned(reinterpret_cast<const double*>(found.gains.data()), found.gains.size(), 2),
                          owned(reinterpret_cast<const double*>(found.phases.data()), found.phases.size(), 3),
                          owned(reinterpret_cast<const double*>(found.peaks.data()), found.peaks.size(), 2), found.half_turns,
                          found.certified);
}

static nb::object complexes(std::vector<Complex> values) {
    auto* copy = new std::vector<Complex>(std::move(values));
    nb::capsule owner(copy, [](void* pointer) noexcept { delete static_cast<std::vector<Complex>*>(pointer); });
    return nb::cast(nb::ndarray<nb::numpy, Complex, nb::ndim<1>>(copy->data(), {copy->size()}, owner));
}

static nb::object scalar_response(Roots zeros, Roots poles, double gain, double delay, double sample_time, Roots points) {
    std::vector<Complex> values(points.size());
    {
        nb::gil_scoped_release release;
        const gainroom::Factors system = factors(zeros, poles, gain);
        for (std::size_t k = 0; k < values.size(); k++) values[k] = gainroom::value_at(system, delay, sample_time, points(k));
    }
    return complexes(std::move(values));
}

static nb::tuple response_and_slope(Roots zeros, Roots poles, double gain, double delay, double sample_time, Vector omega) {
    std::vector<Complex> values(omega.size()), slopes(omega.size());
    {
        nb::gil_scoped_release release;
        const gainroom::Factors system = factors(zeros, poles, gain);
        for (std::size_t k = 0; k < values.size(); k++) {
            Complex slope;
            values[k] = gainroom::value_at(system, delay, sample_time, {0.0, omega(k)}, &slope);
            slopes[k] = gainroom::times(values[k], {-slope.imag(), slope.real()});
        }
    }
    return nb::make_tuple(complexes(std::move(values)), complexes(std::move(slopes)));
}

static nb::tuple sample(Roots zeros, Roots poles, double gain, double sample_time, double fraction) {
    gainroom::Factors found;
    {
        nb::gil_scoped_release release;
        found = gainroom::Sampler(zeros.data(), zeros.size(), poles.data(), poles.size(), gain, sample_time).at(fraction);
    }
    return nb::make_tuple(complexes(std::move(found.zeros)), complexes(std::move(found.poles)), found.gain);
}

static nb::tuple delay_margin(Roots zeros, Roots poles, double gain, double delay, Roots control_zeros, Roots control_poles,
                              double control_gain, double sample_time, int unstable_poles, Matrix crossings) {
    require(crossings.shape(1) == 2, "crossings must have two columns");
    gainroom::DelayMargin found;
    {
        nb::gil_scoped_release release;
        const gainroom::Sampler plant(zeros.data(), zeros.size(), poles.data(), poles.size(), gain, sample_time);
        const gainroom::Factors control = factors(control_zeros, control_poles, control_gain);
        std::vector<std::array<double, 2>> starts;
        for (std::size_t k = 0; k < crossings.shape(0); k++) starts.push_back({crossings(k, 0), crossings(k, 1)});
        found = gainroom::DelayedLoop(plant, control, delay, sample_time, unstable_poles).margin(starts);
    }
    return nb::make_tuple(static_cast<int>(found.found), found.extra, found.omega);
}

static nb::object split_delays(Vector delays, double sample_time) {
    std::vector<double> split;
    for (std::size_t k = 0; k < delays.size(); k++) {
        const auto [whole, fraction] = gainroom::split_delay(delays(k), sample_time);
        split.insert(split.end(), {whole, fraction});
    }
    return owned(split.data(), delays.size(), 2);
}

static double unstable_roots(Matrix gains, Matrix phases, double half_turns, int unstable_poles) {
    require(gains.shape(1) == 2 && phases.shape(1) == 3, "a scan's gains have two columns, its phases three");
    gainroom::Scan scan;
    const auto* gain = reinterpret_cast<const gainroom::GainCrossing*>(gains.data());
    const auto* phase = reinterpret_cast<const gainroom::PhaseCrossing*>(phases.data());
    scan.gains.assign(gain, gain + gains.shape(0));
    scan.phases.assign(phase, phase + phases.shape(0));
    scan.half_turns = half_turns;
    return gainroom::unstable_roots(scan, unstable_poles);
}

static double half_encirclements(double start_phase, bool outside, bool ends_on_boundary, double last_phase, Matrix gains) {
    const auto* first = reinterpret_cast<const gainroom::GainCrossing*>(gains.data());
    return gainroom::Scanner::half_encirclements(start_phase, outside, ends_on_boundary, last_phase, {first, first + gains.shape(0)});
}

static nb::object assigned(Matrix cost) {
    const std::size_t size = cost.shape(0);
    require(cost.shape(1) == size, "cost must be (n, n)");
    require(std::all_of(cost.data(), cost.data() + size * size, [](double one) { return std::isfinite(one); }), "cost must be finite");
    const std::vector<std::size_t> columns = gainroom::assigned(cost.data(), size);
    auto* copy = new std::vector<std::int64_t>(columns.begin(), columns.end());
    nb::capsule owner(copy, [](void* pointer) noexcept { delete static_cast<std::vector<std::int64_t>*>(pointer); });
    return nb::cast(nb::ndarray<nb::numpy, std::int64_t, nb::ndim<1>>(copy->data(), {copy->size()}, owner));
}

void bind_scan(nb::module_& m) {
    m.attr("FLOOR") = gainroom::kFloor;
    m.attr("LOWEST_FLOOR") = gainroom::kLowestFloor;
    m.def("response", &scalar_response, nb::arg("zeros"), nb::arg("poles"), nb::arg("gain"), nb::arg("delay"), nb::arg("sample_time"),
          nb::arg("points"));
    m.def("response_and_slope", &response_and_slope, nb::arg("zeros"), nb::arg("poles"), nb::arg("gain"), nb::arg("delay"),
          nb::arg("sample_time"), nb::arg("omega"));
    m.def("sample", &sample, nb::arg("zeros"), nb::arg("poles"), nb::arg("gain"), nb::arg("sample_time"), nb::arg("fraction"));
    m.def("delay_margin", &delay_margin, nb::arg("zeros"), nb::arg("poles"), nb::arg("gain"), nb::arg("delay"), nb::arg("control_zeros"),
          nb::arg("control_poles"), nb::arg("control_gain"), nb::arg("sample_time"), nb::arg("unstable_poles"), nb::arg("crossings"));
    m.def("assigned", &assigned, nb::arg("cost"));
    m.def("split_delays", &split_delays, nb::arg("delays"), nb::arg("sample_time"));
    m.def("unstable_roots", &unstable_roots, nb::arg("gains"), nb::arg("phases"), nb::arg("half_turns"), nb::arg("unstable_poles"));
    m.def("half_encirclements", &half_encirclements, nb::arg("start_phase"), nb::arg("outside"), nb::arg("ends_on_boundary"),
          nb::arg("last_phase"), nb::arg("gains"));
    m.def("scan", &scan, nb::arg("zeros"), nb::arg("poles"), nb::arg("gain"), nb::arg("delay"), nb::arg("sample_time"),
          nb::arg("with_peaks"));
}
