// numpy arrays in and out. None is copied or converted: the Python side hands over contiguous arrays of the right type.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <complex>
#include <cstdint>
#include <vector>

namespace nb = nanobind;

template <typename T, std::size_t N>
using Array = nb::ndarray<T, nb::numpy, nb::ndim<N>, nb::c_contig, nb::device::cpu>;
using Vector = Array<const double, 1>;
using Matrix = Array<const double, 2>;

// A new numpy array (rows, columns) that owns a copy of `values`.
inline nb::object owned(const double* values, std::size_t rows, std::size_t columns) {
    double* copy = new double[rows * columns + 1];
    std::copy(values, values + rows * columns, copy);
    nb::capsule owner(copy, [](void* pointer) noexcept { delete[] static_cast<double*>(pointer); });
    return nb::cast(nb::ndarray<nb::numpy, double, nb::ndim<2>>(copy, {rows, columns}, owner));
}
