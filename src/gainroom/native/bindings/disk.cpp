#include <functional>

#include "gainroom/disk_peak.hpp"

#include "arrays.hpp"

using gainroom::Complex;
using gainroom::Dense;
using gainroom::DiskModes;
using ComplexMatrix = Array<const Complex, 2>;
using ComplexVector = Array<const Complex, 1>;
using ComplexCube = Array<const Complex, 3>;

static void read(const Complex* from, std::size_t n, Dense& to) {
    to.resize(n, n);
    for (std::size_t k = 0; k < n * n; k++) {
        to.re[k] = from[k].real();
        to.im[k] = from[k].imag();
    }
}

static void write(const Dense& from, Complex* to) {
    for (std::size_t k = 0; k < from.re.size(); k++) to[k] = {from.re[k], from.im[k]};
}

static std::size_t square(const ComplexCube& matrices) {
    require(matrices.shape(1) == matrices.shape(2) && matrices.shape(1) > 0, "matrices must be (k, n, n), n > 0");
    return matrices.shape(1);
}

static nb::object balanced(ComplexCube matrices) {
    const std::size_t n = square(matrices), count = matrices.shape(0);
    gainroom::StructuredValue value(n);
    std::vector<double> x(count * n, 0.0);
    Dense matrix;
    for (std::size_t k = 0; k < count; k++) {
        read(matrices.data() + k * n * n, n, matrix);
        value.balance(matrix, &x[k * n]);
    }
    return owned(x.data(), count, n);
}

static nb::tuple improved(ComplexCube matrices, Matrix start, double tolerance) {
    const std::size_t n = square(matrices), count = matrices.shape(0);
    require(has_shape(start, count, n), "start must be (k, n)");
    gainroom::StructuredValue value(n);
    std::vector<double> x(start.data(), start.data() + count * n), heights(count);
    Dense matrix;
    for (std::size_t k = 0; k < count; k++) {
        read(matrices.data() + k * n * n, n, matrix);
        heights[k] = value.improve(matrix, &x[k * n], tolerance);
    }
    return nb::make_tuple(owned(x.data(), count, n), owned(heights.data(), count, 1));
}

static nb::tuple from_below(ComplexMatrix matrix, double enough) {
    const std::size_t n = matrix.shape(0);
    require(n > 0 && matrix.shape(1) == n, "matrix must be (n, n), n > 0");
    std::vector<Complex> phases(n);
    Dense dense;
    read(matrix.data(), n, dense);
    const double lower = gainroom::StructuredValue(n).from_below(dense, phases.data(), enough);
    return nb::make_tuple(lower, owned(phases.data(), n, 1));
}

static nb::tuple as_tuple(const gainroom::DiskPeak& peak) {
    return nb::make_tuple(peak.height, peak.omega, owned(peak.x.data(), peak.x.size(), 1));
}

using Response = std::function<ComplexMatrix(double)>;

// From samples S − T (k, n, n) at ω (k,), rising, and the response at one more ω.
static nb::tuple disk_peak(Vector omega, ComplexCube samples, const Response& response) {
    const std::size_t n = square(samples), count = omega.size();
    require(samples.shape(0) == count && count > 0, "omega (k,) and samples (k, n, n) do not fit");
    const double* first = omega.data();
    const auto at = [&](double place, Dense& matrix) {
        const std::size_t k = std::size_t(std::lower_bound(first, first + count, place) - first);
        if (k < count && first[k] == place) return read(samples.data() + k * n * n, n, matrix);
        const ComplexMatrix found = response(place);
        require(found.shape(0) == n && found.shape(1) == n, "the response must be (n, n)");
        read(found.data(), n, matrix);
    };
    return as_tuple(gainroom::PeakSearch<decltype(at)>(n, at, first[0], first[count - 1]).from_samples(first, count));
}

static nb::object matrices(const DiskModes& modes, Vector omega) {
    const std::size_t n = modes.size, count = omega.size();
    std::vector<Complex> found(count * n * n);
    gainroom::DiskExpansion expansion(modes);
    Dense matrix;
    for (std::size_t k = 0; k < count; k++) {
        expansion.at(omega.data()[k], matrix);
        write(matrix, &found[k * n * n]);
    }
    return owned(found.data(), count, n * n);
}

static nb::object distances(const DiskModes& modes, Vector low, Vector high) {
    require(low.size() == high.size(), "low (k,) and high (k,) do not fit");
    const std::size_t m = modes.poles.size(), count = low.size();
    std::vector<double> found(count * m);
    const gainroom::DiskExpansion expansion(modes);
    for (std::size_t k = 0; k < count; k++) {
        const double a = low.data()[k], b = high.data()[k];
        for (std::size_t i = 0; i < m; i++) found[k * m + i] = expansion.distance(i, a, b, modes.variable(a), modes.variable(b));
    }
    return owned(found.data(), count, m);
}

// M0, M1, M2 of each interval (k, 3 n²), its bound and remainder (k, 2) with D = e^x.
static nb::tuple bounds(const DiskModes& modes, Vector low, Vector high, Matrix x, double enough) {
    const std::size_t n = modes.size, count = low.size();
    require(high.size() == count && has_shape(x, count, n), "low (k,), high (k,) and x (k, n) do not fit");
    std::vector<Complex> matrices(count * 3 * n * n);
    std::vector<double> found(2 * count, std::numeric_limits<double>::infinity());
    gainroom::DiskExpansion expansion(modes);
    for (std::size_t k = 0; k < count; k++) {
        if (!expansion.expand(low.data()[k], high.data()[k])) continue;
        for (std::size_t order = 0; order < 3; order++) write(expansion.quadratic[order], &matrices[(3 * k + order) * n * n]);
        found[2 * k] = expansion.bound(x.data() + k * n, enough, found[2 * k + 1]);
    }
    return nb::make_tuple(owned(matrices.data(), count, 3 * n * n), owned(found.data(), count, 2));
}

static nb::tuple search(const DiskModes& modes, Vector omega, std::size_t most) {
    gainroom::DiskBound found(modes);
    {
        nb::gil_scoped_release release;
        found.search(omega.data(), omega.size(), most);
    }
    return nb::make_tuple(as_tuple(found.peak), found.bound);
}

void bind_disk(nb::module_& m) {
    m.attr("DISK_TOLERANCE") = gainroom::kDiskTolerance;
    m.def("balanced", &balanced, nb::arg("matrices"));
    m.def("improved", &improved, nb::arg("matrices"), nb::arg("start"), nb::arg("tolerance"));
    m.def("from_below", &from_below, nb::arg("matrix"), nb::arg("enough"));
    m.def("disk_peak", &disk_peak, nb::arg("omega"), nb::arg("samples"), nb::arg("response"));
    nb::class_<DiskModes>(m, "DiskModes")
        .def("__init__",
             [](DiskModes* self, ComplexVector poles, ComplexMatrix into, ComplexMatrix out, Vector delays, Vector share, double step) {
                 const std::size_t n = delays.size(), modes = poles.shape(0);
                 require(n > 0 && share.size() == n && into.shape(0) == modes && into.shape(1) == n &&
                             out.shape(0) == modes && out.shape(1) == n,
                         "poles (m,), into (m, n), out (m, n), delays and share (n,) do not fit");
                 new (self) DiskModes{n,
                                      {poles.data(), poles.data() + modes},
                                      {into.data(), into.data() + modes * n},
                                      {out.data(), out.data() + modes * n},
                                      {delays.data(), delays.data() + n},
                                      {share.data(), share.data() + n},
                                      step};
             },
             nb::arg("poles"), nb::arg("into"), nb::arg("out"), nb::arg("delays"), nb::arg("share"), nb::arg("step"))
        .def("matrices", &matrices, nb::arg("omega"))
        .def("distances", &distances, nb::arg("low"), nb::arg("high"))
        .def("bounds", &bounds, nb::arg("low"), nb::arg("high"), nb::arg("x"), nb::arg("enough"))
        .def("end", [](const DiskModes& modes, double height) { return gainroom::DiskExpansion(modes).end(height); }, nb::arg("height"))
        .def("search", &search, nb::arg("omega"), nb::arg("most"));
}
