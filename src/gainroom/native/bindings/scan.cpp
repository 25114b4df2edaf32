#include "gainroom/scan.hpp"

#include "arrays.hpp"

using gainroom::Complex;
using Roots = Array<const Complex, 1>;

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

static double half_encirclements(double start_phase, bool outside, bool ends_on_boundary, double last_phase, Matrix gains) {
    const auto* first = reinterpret_cast<const gainroom::GainCrossing*>(gains.data());
    return gainroom::Scanner::half_encirclements(start_phase, outside, ends_on_boundary, last_phase, {first, first + gains.shape(0)});
}

void bind_scan(nb::module_& m) {
    m.attr("FLOOR") = gainroom::kFloor;
    m.attr("LOWEST_FLOOR") = gainroom::kLowestFloor;
    m.def("half_encirclements", &half_encirclements, nb::arg("start_phase"), nb::arg("outside"), nb::arg("ends_on_boundary"),
          nb::arg("last_phase"), nb::arg("gains"));
    m.def("scan", &scan, nb::arg("zeros"), nb::arg("poles"), nb::arg("gain"), nb::arg("delay"), nb::arg("sample_time"),
          nb::arg("with_peaks"));
}
