// One curve of a coupled loop at one frequency: a locus with its vectors, or S_ii and the return ratio of a loop; and how it moves with gains.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "block.hpp"
#include "dense.hpp"
#include "directed_loop.hpp"
#include "loop_sample.hpp"

namespace gainroom {

inline Complex log_of_minus(Complex value) { return {log_size(value), std::arg(-value)}; }

class CurveValue {
public:
    explicit CurveValue(DirectedLoop& loop) : loop_(loop), n_(loop.size()), m_(loop.directions) {}

    // A locus, or loop `which`.
    void begin(bool locus, std::size_t which) {
        locus_ = locus;
        which_ = which;
        follow_.clear();
    }

    // The value of a curve at one frequency, of these gains; a locus is followed by its vectors, at first the one that is nearest to `guess`.
    bool evaluate(double omega, const DirectedGains& gains, Complex guess, Complex& value) {
        if (!loop_.point(omega, point_)) return false;
        law_.resize(m_);
        change_.resize(2 * m_);
        loop_.law(point_, gains, law_.data(), change_.data());
        if (locus_) return follow(guess, value);
        matrix_.shape(m_, m_);
        for (std::size_t i = 0; i < m_; i++)
            for (std::size_t j = 0; j < m_; j++) matrix_.set(i, j, times(point_.seen[i * m_ + j], law_[j]) + (i == j ? 1.0 : 0.0));
        if (!factorise(matrix_, exchanged_)) return false;
        const std::vector<Complex>& reached = loop_.own() ? point_.seen : point_.reached;
        row_.resize(m_);  // of P X Δ V
        for (std::size_t l = 0; l < m_; l++) row_[l] = times(reached[which_ * m_ + l], law_[l]);
        solve_transposed(matrix_, exchanged_, row_.data());
        sensitivity_ = 1.0;
        for (std::size_t k = 0; k < m_; k++) sensitivity_ -= row_[k] * jacobian(k, which_);
        value = return_ratio(sensitivity_);
        return true;
    }

    // LoopSample::closed, of the loop that was evaluated last.
    Complex closed(Gain gain) {
        if (gain == Gain::all) return 1.0 - sensitivity_;
        column_.resize(m_);
        for (std::size_t k = 0; k < m_; k++) column_[k] = point_.seen[k * m_ + which_];
        solve_factorised(matrix_, exchanged_, column_.data());
        return times(column_[which_], DirectedLoop::unit(point_, gain));
    }

    // Changes of ln of the value that was evaluated last, into growth_ (2, m).
    void grow() {
        growth_.resize(2 * m_);
        if (!locus_) {
            grow_sensitivity();
            const Complex factor = over(-1.0, times(times(sensitivity_, sensitivity_), return_ratio(sensitivity_)));  // dℓ = −dS/S²
            for (Complex& one : growth_) one = times(one, factor);
            return;
        }
        const Complex *x = follow_.data(), *y = x + m_;
        Complex both = 0.0;
        for (std::size_t i = 0; i < m_; i++) both += times(y[i], x[i]);
        const Complex scale = over(1.0, times(both, quotient(x, y)));
        for (std::size_t j = 0; j < m_; j++) {
            Complex sum = 0.0;
            for (std::size_t i = 0; i < m_; i++) sum += times(y[i], point_.seen[i * m_ + j]);
            const Complex weight = times(times(sum, x[j]), scale);
            growth_[j] = times(weight, change_[j]);
            growth_[m_ + j] = times(weight, change_[m_ + j]);
        }
    }

    // Changes of S_ii as evaluated last, into growth_.
    void grow_sensitivity() {
        growth_.resize(2 * m_);
        const std::vector<Complex>& reached = loop_.own() ? point_.seen : point_.reached;
        column_.resize(m_);  // of V E
        for (std::size_t k = 0; k < m_; k++) column_[k] = jacobian(k, which_);
        solve_factorised(matrix_, exchanged_, column_.data());
        for (std::size_t j = 0; j < m_; j++) {
            Complex row = reached[which_ * m_ + j];
            for (std::size_t k = 0; k < m_; k++) row -= times(row_[k], point_.seen[k * m_ + j]);
            const Complex weight = -times(row, column_[j]);
            growth_[j] = times(weight, change_[j]);
            growth_[m_ + j] = times(weight, change_[m_ + j]);
        }
    }

    Complex sensitivity() const { return sensitivity_; }
    const std::vector<Complex>& growth() const { return growth_; }

private:
    double jacobian(std::size_t direction, std::size_t joint) const {
        return loop_.own() ? (direction == joint ? 1.0 : 0.0) : loop_.jacobian[direction * n_ + joint];
    }

    // The eigenvalue of Q with its vectors x (right) and y (left), by Rayleigh quotients (Ostrowski 1959).
    bool follow(Complex guess, Complex& value) {
        loop_matrix_.resize(m_ * m_);
        for (std::size_t i = 0; i < m_; i++)
            for (std::size_t j = 0; j < m_; j++) loop_matrix_[i * m_ + j] = times(point_.seen[i * m_ + j], law_[j]);
        const bool begun = !follow_.empty();
        follow_.resize(2 * m_);
        Complex* x = follow_.data();
        Complex* y = x + m_;
        value = begun ? quotient(x, y) : guess;
        for (int round = 0; round < 8; round++) {
            const bool first = !begun && round == 0;
            Complex shift = value;
            for (int attempt = 0;; attempt++) {
                matrix_.shape(m_, m_);
                for (std::size_t i = 0; i < m_; i++)
                    for (std::size_t j = 0; j < m_; j++) matrix_.set(i, j, loop_matrix_[i * m_ + j] - (i == j ? shift : Complex(0.0)));
                LogDeterminant determinant;
                if (first ? invert(matrix_, exchanged_, determinant) : factorise(matrix_, exchanged_)) break;
                if (attempt == 3) return false;
                shift = value * (1 + std::pow(10.0, attempt - 15)) + 1e-300;
            }
            if (first) {
                largest(x, y);
            } else {
                solve_factorised(matrix_, exchanged_, x);
                solve_transposed(matrix_, exchanged_, y);
                normalise(x);
                normalise(y);
            }
            const Complex found = quotient(x, y);
            if (!std::isfinite(found.real()) || !std::isfinite(found.imag())) return false;
            const double moved = size_of_any(found - value);
            value = found;
            if (moved <= kCubed * size_of_any(value)) break;
        }
        return true;
    }

    Complex quotient(const Complex* x, const Complex* y) const {
        Complex above = 0.0, below = 0.0;
        for (std::size_t i = 0; i < m_; i++) {
            Complex sum = 0.0;
            for (std::size_t j = 0; j < m_; j++) sum += times(loop_matrix_[i * m_ + j], x[j]);
            above += times(y[i], sum);
            below += times(y[i], x[i]);
        }
        return over(above, below);
    }

    // The largest column and row of (Q − shift)⁻¹, which is about x y/(λ − shift).
    void largest(Complex* x, Complex* y) const {
        std::size_t row = 0, column = 0;
        double most_row = -1.0, most_column = -1.0;
        for (std::size_t i = 0; i < m_; i++) {
            double own_row = 0.0, own_column = 0.0;
            for (std::size_t j = 0; j < m_; j++) {
                own_row += std::norm(matrix_.at(i, j));
                own_column += std::norm(matrix_.at(j, i));
            }
            if (own_row > most_row) {
                most_row = own_row;
                row = i;
            }
            if (own_column > most_column) {
                most_column = own_column;
                column = i;
            }
        }
        for (std::size_t i = 0; i < m_; i++) {
            x[i] = matrix_.at(i, column);
            y[i] = matrix_.at(row, i);
        }
        normalise(x);
        normalise(y);
    }

    void normalise(Complex* vector) const {
        double size = 0.0;
        for (std::size_t i = 0; i < m_; i++) size = std::max(size, size_of_any(vector[i]));
        for (std::size_t i = 0; i < m_ && size > 0; i++) vector[i] /= size;
    }

    static constexpr double kCubed = 1e-7;  // a move; what is left is about its third power: quotients of both vectors converge cubically

    DirectedLoop& loop_;
    std::size_t n_, m_, which_ = 0;
    bool locus_ = false;
    LoopPoint point_;
    std::vector<Complex> law_, change_, row_, column_, loop_matrix_, follow_, growth_;
    Complex sensitivity_;
    Dense matrix_;
    Vector<std::size_t> exchanged_;
};

}  // namespace gainroom
