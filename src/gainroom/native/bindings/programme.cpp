#include "gainroom/quadratic_programme.hpp"

#include "arrays.hpp"

static void require_finite(const double* values, std::size_t count) {
    for (std::size_t k = 0; k < count; k++) require(std::isfinite(values[k]), "all numbers must be finite");
}

static std::vector<double> numbers(const Vector& from) { return {from.data(), from.data() + from.size()}; }

void bind_programme(nb::module_& m) {
    m.def(
        "quadratic_programme",
        [](Vector bend, Vector pull, Matrix slope, Vector value, double penalty, Vector low, Vector high) {
            const std::size_t n = bend.size();
            require(pull.size() == n && low.size() == n && high.size() == n, "bend, pull, low and high must have one shape (n,)");
            require(has_shape(slope, value.size(), n), "slope must have the shape (m, n), and value (m,)");
            for (const Vector* each : {&bend, &pull, &value, &low, &high}) require_finite(each->data(), each->size());
            require_finite(slope.data(), slope.size());
            require_finite(&penalty, 1);
            std::vector<double> found;
            {
                nb::gil_scoped_release release;
                found = gainroom::quadratic_programme(numbers(bend), numbers(pull), slope.data(), numbers(value), penalty, numbers(low),
                                                      numbers(high));
            }
            return nb::make_tuple(owned(found.data(), 1, n), found[n]);
        },
        nb::arg("bend"), nb::arg("pull"), nb::arg("slope"), nb::arg("value"), nb::arg("penalty"), nb::arg("low"), nb::arg("high"),
        "The x (1, n) with low <= x <= high, and t >= 0, that make 1/2 sum bend x^2 + pull.x + penalty t + 1/2 t^2 smallest with value + slope x "
        "<= t (m,).");
}
