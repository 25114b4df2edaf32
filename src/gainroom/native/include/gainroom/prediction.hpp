// One-step predictions of a linear system with a constant Kalman gain.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace gainroom {

// x⁺ = a x + b u + gain e, e = y − c x, with n states, i inputs and o outputs. Matrices are row by row.
struct Predictor {
    std::size_t states, inputs, outputs;
    const double *a, *b, *c;  // (n, n), (n, i), (o, n)
    const double* gains;      // (r, n, o), one for each regime
};

// Fills errors e (m, o) from `state` (n), which is changed. regime (m): which gain each row takes; inputs (m, i) over the tick that begins
// with each row; outputs y (m, o).
inline void predict(const Predictor& model, const std::int64_t* regime, const double* inputs, const double* outputs, std::size_t rows,
                    double* state, double* errors) {
    const std::size_t size = model.states, count = model.inputs, seen = model.outputs;
    std::vector<double> fresh(size);
    for (std::size_t k = 0; k < rows; k++, inputs += count, outputs += seen, errors += seen) {
        const double* gain = model.gains + static_cast<std::size_t>(regime[k]) * size * seen;
        for (std::size_t j = 0; j < seen; j++) {
            double value = outputs[j];
            for (std::size_t i = 0; i < size; i++) value -= model.c[j * size + i] * state[i];
            errors[j] = value;
        }
        for (std::size_t i = 0; i < size; i++) {
            double value = 0.0;
            for (std::size_t j = 0; j < size; j++) value += model.a[i * size + j] * state[j];
            for (std::size_t j = 0; j < count; j++) value += model.b[i * count + j] * inputs[j];
            for (std::size_t j = 0; j < seen; j++) value += gain[i * seen + j] * errors[j];
            fresh[i] = value;
        }
        for (std::size_t i = 0; i < size; i++) state[i] = fresh[i];
    }
}

}  // namespace gainroom
