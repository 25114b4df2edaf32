// F = Q + v D of coupled joints at one ω after the other, in units or mixed coordinates chosen for an interval (exclusion.hpp).
#pragma once

#include <cstdint>

#include "mixing.hpp"
#include "mode_sum.hpp"

namespace gainroom {

class SampledForm {
   protected:
    SampledForm(const ModalLoop& loop, double v, double alignment, const Complex* crossing, std::size_t crossing_count)
        : loop_(loop),
          sum_(loop),
          v_(v),
          n_(loop.size),
          stride_(sum_.stride),
          scale_(loop.size),
          crossing_(crossing, crossing + crossing_count * loop.size),
          alignment_(alignment) {}

    struct Node {
        double omega = 0.0;
        std::vector<double> real, imaginary;  // upper triangle of Q + v D, aligned and scaled
        std::vector<Complex> law;             // d_i, likewise
        std::vector<double> size;             // |1/c_i|
        std::vector<double> round_off;        // of Q, as a diagonal matrix
        std::vector<double> law_real, law_imaginary;  // upper triangle of Tᵀ D T, where unknowns are mixed
        std::vector<Complex> pivots;  // of F at the factor 1; empty until asked for
        void resize(std::size_t n, std::size_t stride, bool mixed) {
            real.resize(n * stride);
            imaginary.resize(n * stride);
            law.resize(n);
            size.resize(n);
            round_off.resize(n);
            law_real.resize(mixed ? n * stride : 0);
            law_imaginary.resize(mixed ? n * stride : 0);
            pivots.clear();
        }
    };

    const ModalLoop& loop_;
    ModeSum sum_;
    const double v_;
    const std::size_t n_, stride_;
    double mixing_size_ = 1.0;  // bound of |T|²
    std::vector<Complex> scale_;
    std::int64_t samples_ = 0;

    bool mixed() const { return !crossing_.empty(); }
    bool whole() const { return crossing_.size() == n_ * n_; }

    // to_j += factor from_j.
    static void add_scaled(double factor, const double* __restrict from, double* __restrict to, std::size_t count) {
        for (std::size_t j = 0; j < count; j++) to[j] += factor * from[j];
    }

    // Units in which every d_i has size 1 in the middle, and as much of a common phase as is asked for: a congruence.
    void align(double low, double high) {
        const double middle = std::sqrt(low * high);
        Complex mean = 0.0;
        loop_.inverse_laws(middle, scale_.data());
        for (std::size_t i = 0; i < n_; i++) mean += scale_[i] / std::abs(scale_[i]);
        for (std::size_t i = 0; i < n_; i++) {
            const double turn = alignment_ == 0 ? 0.0 : 0.5 * alignment_ * turn_between(scale_[i], mean);
            scale_[i] = std::polar(1 / std::sqrt(std::abs(scale_[i])), turn);
        }
        if (alignment_ == 0 && !mixed()) {
            std::vector<double> units(n_);
            for (std::size_t i = 0; i < n_; i++) units[i] = scale_[i].real();
            sum_.set_units(units);
            return;
        }
        std::vector<Complex> rigid(n_ * n_), shapes(loop_.modes * n_);
        for (std::size_t k = 0; k < loop_.modes; k++)
            for (std::size_t i = 0; i < n_; i++) shapes[k * n_ + i] = times(scale_[i], loop_.shapes[k * n_ + i]);
        for (std::size_t i = 0; i < n_; i++)
            for (std::size_t j = 0; j < n_; j++) rigid[i * n_ + j] = times(times(scale_[i], scale_[j]), loop_.rigid_at(i * n_ + j));
        std::vector<double> rigid_made_of(n_), made_of(loop_.modes * n_);
        if (mixed()) {
            mix(rigid, shapes, rigid_made_of, made_of);
        } else {
            for (std::size_t k = 0; k < made_of.size(); k++) made_of[k] = size_of(shapes[k]);
            for (std::size_t k = 0; k < rigid.size(); k++) rigid_made_of[k / n_] += size_of(rigid[k]);
        }
        sum_.set_coordinates(rigid, shapes, rigid_made_of, made_of);
    }

    void sample(Node& node, double omega) {
        samples_++;
        node.resize(n_, stride_, mixed());
        node.omega = omega;
        sum_.respond(omega, node.real.data(), node.imaginary.data(), node.round_off.data());
        loop_.inverse_laws(omega, node.law.data());
        for (std::size_t i = 0; i < n_; i++) {
            node.size[i] = ModalLoop::inverse_law_size(node.law[i], omega, loop_.step);
            node.law[i] = times(node.law[i], times(scale_[i], scale_[i]));
            if (!mixed()) {
                node.real[i * stride_ + i] += v_ * node.law[i].real();
                node.imaginary[i * stride_ + i] += v_ * node.law[i].imag();
            }
        }
        if (!mixed()) return;
        std::fill(node.law_real.begin(), node.law_real.end(), 0.0);
        std::fill(node.law_imaginary.begin(), node.law_imaginary.end(), 0.0);
        for (std::size_t k = 0; k < n_; k++)
            for (std::size_t i = 0; i < n_; i++) {
                const Complex left = times(node.law[k], mixing_[k * n_ + i]);
                if (left == 0.0) continue;
                for (std::size_t j = i; j < n_; j++) {
                    const Complex value = times(left, mixing_[k * n_ + j]);
                    node.law_real[i * stride_ + j] += value.real();
                    node.law_imaginary[i * stride_ + j] += value.imag();
                }
            }
        add_scaled(v_, node.law_real.data(), node.real.data(), n_ * stride_);
        add_scaled(v_, node.law_imaginary.data(), node.imaginary.data(), n_ * stride_);
    }

    // Σ arg(e^{jθ} p_i)
    double argument(Node& node, double angle) {
        double sum = 0.0;
        const Complex turn = std::polar(1.0, angle);
        for (const Complex pivot : pivots(node)) sum += std::arg(times(turn, pivot));
        return sum;
    }

    // arg det(I + L) where that is near I: the pivots of D⁻¹F are p_i/d_i.
    double argument_of_loop(Node& node) {
        double sum = 0.0;
        for (std::size_t i = 0; i < n_; i++) sum += std::arg(over(pivots(node)[i], node.law[i]));
        return sum;
    }

   private:
    const std::vector<Complex> crossing_;  // X (count, n)
    const double alignment_;
    std::vector<Complex> mixing_, pivots_;  // T (n, n)

    // Of Q + D, by Gauss without exchanges.
    const std::vector<Complex>& pivots(Node& node) {
        if (!node.pivots.empty()) return node.pivots;
        pivots_.resize(n_ * n_);
        for (std::size_t i = 0; i < n_; i++)
            for (std::size_t j = i; j < n_; j++) {
                const std::size_t at = i * stride_ + j;
                Complex law = 0.0;
                if (mixed())
                    law = {node.law_real[at], node.law_imaginary[at]};
                else if (i == j)
                    law = node.law[i];
                pivots_[i * n_ + j] = Complex(node.real[at], node.imaginary[at]) + (1 - v_) * law;
            }
        for (std::size_t k = 0; k < n_; k++) {
            node.pivots.push_back(pivots_[k * n_ + k]);
            for (std::size_t i = k + 1; i < n_; i++) {
                const Complex factor = over(pivots_[k * n_ + i], pivots_[k * n_ + k]);
                if (factor == 0.0) continue;
                for (std::size_t j = i; j < n_; j++) pivots_[i * n_ + j] -= times(factor, pivots_[k * n_ + j]);
            }
        }
        return node.pivots;
    }

    // T, and what it makes of M₀ and of the modes; with the sizes of what is summed up.
    void mix(std::vector<Complex>& rigid, std::vector<Complex>& shapes, std::vector<double>& rigid_made_of, std::vector<double>& made_of) {
        mixing_ = mixing_of(crossing_, scale_, mixing_size_);
        std::vector<double> sizes(n_ * n_), rows(n_, 0.0), across(n_, 0.0);
        for (std::size_t k = 0; k < n_ * n_; k++) sizes[k] = size_of(mixing_[k]);
        for (std::size_t i = 0; i < n_; i++)
            for (std::size_t j = 0; j < n_; j++) rows[i] += sizes[i * n_ + j];
        for (std::size_t i = 0; i < n_; i++)
            for (std::size_t j = 0; j < n_; j++) across[i] += size_of(rigid[i * n_ + j]) * rows[j];
        for (std::size_t j = 0; j < n_; j++)
            for (std::size_t i = 0; i < n_; i++) {
                rigid_made_of[j] += sizes[i * n_ + j] * across[i];
                for (std::size_t k = 0; k < loop_.modes; k++) made_of[k * n_ + j] += size_of(shapes[k * n_ + i]) * sizes[i * n_ + j];
            }
        std::vector<Complex> row(n_), half(n_ * n_);
        for (std::size_t k = 0; k < loop_.modes; k++) {
            for (std::size_t j = 0; j < n_; j++) row[j] = mixed_row(&shapes[k * n_], j);
            std::copy(row.begin(), row.end(), &shapes[k * n_]);
        }
        for (std::size_t i = 0; i < n_; i++)
            for (std::size_t j = 0; j < n_; j++) half[j * n_ + i] = mixed_row(&rigid[i * n_], j);  // (M T)ᵀ
        for (std::size_t i = 0; i < n_; i++)
            for (std::size_t j = 0; j < n_; j++) rigid[j * n_ + i] = mixed_row(&half[i * n_], j);
    }

    // Σ_i row_i T_ij
    Complex mixed_row(const Complex* row, std::size_t j) const {
        Complex value = 0.0;
        for (std::size_t i = 0; i < n_; i++)
            if (row[i] != 0.0) value += times(row[i], mixing_[i * n_ + j]);
        return value;
    }
};

}  // namespace gainroom
