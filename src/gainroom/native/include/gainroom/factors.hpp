// A scalar transfer function as zeros, poles and gain, and its value anywhere: gain Π(v − zeros)/Π(v − poles) e^{−sT}.
#pragma once

#include <algorithm>
#include <vector>

#include "complex.hpp"

namespace gainroom {

struct Factors {
    std::vector<Complex> zeros, poles;
    double gain = 0.0;
};

// v at s: s itself in continuous time (sample_time 0), else (e^{s T_s} − 1)/T_s without cancellation.
inline Complex variable(Complex s, double sample_time) {
    if (!(sample_time > 0)) return s;
    const double x = s.real() * sample_time, y = s.imag() * sample_time, half = std::sin(y / 2);
    return Complex(std::expm1(x) * std::cos(y) - 2 * half * half, std::exp(x) * std::sin(y)) / sample_time;
}

// e^{−sT}
inline Complex late_by(double delay, Complex s) {
    const double turned = s.imag() * delay;
    return std::exp(-s.real() * delay) * Complex(std::cos(turned), -std::sin(turned));
}

// The value at v without the delay, infinite or NaN on a pole; `slope` receives the derivative by v of its logarithm where it is given.
inline Complex rational_at(const Factors& system, Complex v, Complex* slope = nullptr) {
    Complex value = system.gain, terms = 0.0;
    // Zero by pole, so that the product stays within range for any number of factors.
    for (std::size_t k = 0; k < std::max(system.zeros.size(), system.poles.size()); k++) {
        if (k < system.zeros.size()) {
            const Complex distance = v - system.zeros[k];
            value = times(value, distance);
            if (slope != nullptr) terms += inverse_of(distance);
        }
        if (k < system.poles.size()) {
            const Complex distance = v - system.poles[k], inverse = inverse_of(distance);
            value = distance == 0.0 ? Complex(value.real() / 0.0, value.imag() / 0.0) : times(value, inverse);
            terms -= inverse;
        }
    }
    if (slope != nullptr) *slope = terms;
    return value;
}

// The value at s, likewise, and the derivative by s.
inline Complex value_at(const Factors& system, double delay, double sample_time, Complex s, Complex* slope = nullptr) {
    const Complex value = rational_at(system, variable(s, sample_time), slope);
    if (slope != nullptr) *slope = (sample_time > 0 ? times(*slope, std::exp(s * sample_time)) : *slope) - delay;
    return delay > 0 ? times(value, late_by(delay, s)) : value;
}

}  // namespace gainroom
