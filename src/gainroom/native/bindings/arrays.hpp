// numpy arrays in and out. What is read should be contiguous and of the right type, else it is copied; what is written has to be.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/function.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/vector.h>

#include <complex>
#include <cstdint>
#include <vector>

#include "gainroom/factors.hpp"

namespace nb = nanobind;

template <typename T, std::size_t N>
using Array = nb::ndarray<T, nb::numpy, nb::ndim<N>, nb::c_contig, nb::device::cpu>;
using Vector = Array<const double, 1>;
using Matrix = Array<const double, 2>;
using Cube = Array<const double, 3>;
using Roots = Array<const gainroom::Complex, 1>;
using Integers = Array<const std::int64_t, 1>;

inline void require(bool fits, const char* message) {
    if (!fits) throw nb::value_error(message);
}

inline bool has_shape(const Matrix& array, std::size_t rows, std::size_t columns) {
    return array.shape(0) == rows && array.shape(1) == columns;
}

inline gainroom::Factors factors(const Roots& zeros, const Roots& poles, double gain) {
    return {{zeros.data(), zeros.data() + zeros.size()}, {poles.data(), poles.data() + poles.size()}, gain};
}

// A new numpy array (rows, columns) that owns a copy of `values`.
template <typename T>
nb::object owned(const T* values, std::size_t rows, std::size_t columns) {
    T* copy = new T[rows * columns + 1];
    std::copy(values, values + rows * columns, copy);
    nb::capsule owner(copy, [](void* pointer) noexcept { delete[] static_cast<T*>(pointer); });
    return nb::cast(nb::ndarray<nb::numpy, T, nb::ndim<2>>(copy, {rows, columns}, owner));
}
