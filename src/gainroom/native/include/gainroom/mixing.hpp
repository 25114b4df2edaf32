// Coordinates in which vectors of roots that are about to cross are real (exclusion.hpp).
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

#include "complex.hpp"

namespace gainroom {

// T (n, n) from n vectors (rows of `vectors`, in units of `scale`): as they are, but for their sizes.
inline std::vector<Complex> basis_of(const std::vector<Complex>& vectors, const std::vector<Complex>& scale, double& size) {
    const std::size_t n = scale.size();
    std::vector<Complex> mixing(n * n);
    size = static_cast<double>(n);
    for (std::size_t k = 0; k < n; k++) {
        double square = 0.0;
        for (std::size_t i = 0; i < n; i++) square += std::norm(over(vectors[k * n + i], scale[i]));
        for (std::size_t i = 0; i < n; i++) mixing[i * n + k] = over(vectors[k * n + i], scale[i]) / std::sqrt(square);
    }
    return mixing;
}

// A (m, m) → A⁻¹, by Gauss and Jordan without exchanges: for positive definite ones; others give anything.
inline std::vector<double> inverted(std::vector<double> matrix, std::size_t m) {
    std::vector<double> inverse(m * m, 0.0);
    for (std::size_t k = 0; k < m; k++) inverse[k * m + k] = 1.0;
    for (std::size_t k = 0; k < m; k++) {
        const double pivot = 1 / matrix[k * m + k];
        for (std::size_t l = 0; l < m; l++) {
            matrix[k * m + l] *= pivot;
            inverse[k * m + l] *= pivot;
        }
        for (std::size_t r = 0; r < m; r++) {
            if (r == k) continue;
            const double factor = matrix[r * m + k];
            for (std::size_t l = 0; l < m; l++) {
                matrix[r * m + l] -= factor * matrix[k * m + l];
                inverse[r * m + l] -= factor * inverse[k * m + l];
            }
        }
    }
    return inverse;
}

// T (n, n) = I + j U (VᵀV)⁻¹ Vᵀ of fewer vectors V + j U, each turned to be as real as it can be; of n: basis_of. `size`: bound of |T|².
inline std::vector<Complex> mixing_of(const std::vector<Complex>& vectors, const std::vector<Complex>& scale, double& size) {
    const std::size_t n = scale.size(), count = vectors.size() / n;
    if (count == n) return basis_of(vectors, scale, size);
    std::vector<double> real(count * n), imaginary(count * n), gram(count * count, 0.0);
    std::vector<Complex> own(n);
    for (std::size_t k = 0; k < count; k++) {
        Complex square = 0.0;
        double norm = 0.0;
        for (std::size_t i = 0; i < n; i++) {
            own[i] = over(vectors[k * n + i], scale[i]);
            square += times(own[i], own[i]);
            norm += std::norm(own[i]);
        }
        const Complex turn = std::polar(1 / std::sqrt(norm), -0.5 * std::arg(square));
        for (std::size_t i = 0; i < n; i++) {
            const Complex value = times(own[i], turn);
            real[k * n + i] = value.real();
            imaginary[k * n + i] = value.imag();
        }
    }
    for (std::size_t k = 0; k < count; k++)
        for (std::size_t l = 0; l < count; l++)
            for (std::size_t i = 0; i < n; i++) gram[k * count + l] += real[k * n + i] * real[l * n + i];
    const std::vector<double> inverse = inverted(gram, count);  // vectors that are alike: then nothing is proved
    std::vector<Complex> mixing(n * n);
    double away = 0.0;
    for (std::size_t i = 0; i < n; i++)
        for (std::size_t j = 0; j < n; j++) {
            double value = 0.0;
            for (std::size_t k = 0; k < count; k++)
                for (std::size_t l = 0; l < count; l++) value += imaginary[k * n + i] * inverse[k * count + l] * real[l * n + j];
            mixing[i * n + j] = Complex(i == j ? 1.0 : 0.0, value);
            away += value * value;
        }
    size = (1 + std::sqrt(away)) * (1 + std::sqrt(away));
    return mixing;
}

}  // namespace gainroom
