// Intervals of ω in which no factor on all gains, up to some g, puts a closed-loop root of coupled joints on the boundary.
//
// With factors κ = 1/(ρ v), v = 1/g and ρ >= 1, a root at jω makes F = Q + ρ v D singular: Q = x P, D = diag(d_i) (modal_loop.hpp).
// F is complex symmetric. If one angle θ makes
//
//   Re(e^{jθ} (Q + v D)) > 0   and   Re(e^{jθ} D) > 0,
//
// then Re(e^{jθ} F) > 0 for all of them: none puts a root there. Over an interval both sides are interpolated between its ends; what
// interpolation misses of Q is at most Σ |φ_k φ_kᵀ| e_k, with the e_k of modal_loop.hpp, and is taken off. A failed Cholesky factorisation
// gives an x for which only part of a circle of angles is left: the cuts find an angle or show that there is none. (As D is diagonal, each
// joint may even have its own ρ.)
//
// Just below a limit that is not enough: the vector x of the root that is about to cross is complex, while the test asks about real ones.
// There unknowns are mixed by T = I + j U (VᵀV)⁻¹ Vᵀ, X = V + j U the vectors of roots that cross: T V = X, so that they become real, and
// Tᵀ D T takes the place of D. Then the test holds as near to the limit as one likes. n vectors are T itself: those that make Q and D
// diagonal at one ω, each turned so that θ = 0 serves it, decide all about it.
#pragma once

#include <cstdint>

#include "mixing.hpp"
#include "modal_loop.hpp"

namespace gainroom {

struct Interval {
    double low, high;
};

class Exclusion {
   public:
    // `alignment`: part of the joints' phase differences that is turned away beforehand, 0 to 1. `crossing`: X (count, n).
    Exclusion(const ModalLoop& loop, double gain, double alignment, const Complex* crossing = nullptr, std::size_t crossing_count = 0)
        : loop_(loop),
          crossing_(crossing, crossing + crossing_count * loop.size),
          v_(1 / gain),
          alignment_(alignment),
          n_(loop.size),
          m_(loop.modes) {
        const std::size_t square = n_ * n_;
        scale_.resize(n_);
        rigid_.resize(square);
        shapes_.resize(m_ * n_);
        shapes_real_.resize(m_ * n_);
        shapes_imaginary_.resize(m_ * n_);
        spread_.resize(n_);
        functions_.resize(m_);
        bends_.resize(m_);
        law_bends_.resize(n_);
        missed_.resize(square);
        trial_.resize(square);
        vector_.resize(n_);
        column_.resize(n_);
        for (Node& node : nodes_) node.resize(n_, mixed());
    }

    // Appends the parts of [low, high] that are left undecided at a relative width of `floor`; angles are carried from cell to cell.
    // Once `most` samples have been taken, in all runs, nothing more is decided.
    void run(double low, double high, double floor, std::int64_t most, std::vector<Interval>& undecided) {
        if (!(high > low) || !(low > 0)) return;
        align(low, high);
        int free[kDepth + 2], stack[kDepth + 2], left = 0, depth = 0, spare = 0;
        for (int k = 2; k < kDepth + 2; k++) free[spare++] = k;
        sample(nodes_[left], low);
        sample(nodes_[1], high);
        stack[0] = 1;
        while (depth >= 0) {
            const int right = stack[depth];
            const double a = nodes_[left].omega, b = nodes_[right].omega;
            const bool decided = samples_ < most && excluded(nodes_[left], nodes_[right]);
            if (!decided && b - a > floor * b && spare > 0 && samples_ < most) {
                const int middle = free[--spare];
                sample(nodes_[middle], b > 1.5 * a ? std::sqrt(a * b) : 0.5 * (a + b));
                if (mixed() || b - a > kCoarse * b || excluded(nodes_[middle], nodes_[middle])) {
                    stack[++depth] = middle;
                    continue;
                }
                free[spare++] = middle;  // not even by itself: nothing is gained by halving
            }
            if (!decided) add(undecided, a, b);
            free[spare++] = left;
            left = right;
            depth--;
        }
    }

   private:
    static constexpr int kDepth = 48, kCuts = 24;
    static constexpr double kRounding = 1e-13, kSmall = 1e-4, kCoarse = 0.05;

    struct Node {
        double omega = 0.0;
        std::vector<double> real, imaginary;  // upper triangle of Q + v D, aligned and scaled
        std::vector<Complex> law;             // d_i, likewise
        std::vector<double> size;             // |1/c_i|
        std::vector<double> law_real, law_imaginary;  // upper triangle of Tᵀ D T, where unknowns are mixed
        void resize(std::size_t n, bool mixed) {
            real.resize(n * n);
            imaginary.resize(n * n);
            law.resize(n);
            size.resize(n);
            law_real.resize(mixed ? n * n : 0);
            law_imaginary.resize(mixed ? n * n : 0);
        }
    };

    // A matrix that has to be positive: Re(e^{jθ} (real + j imaginary)) less what may be missed.
    struct Test {
        const double *real, *imaginary, *missed;
    };

    const ModalLoop& loop_;
    std::vector<Complex> crossing_, mixing_, column_;  // X (count, n), T (n, n)
    std::vector<double> law_missed_;                   // as `missed_`, of Tᵀ D T
    double mixing_size_ = 1.0;                         // bound of |T|²
    double v_, alignment_;
    std::size_t n_, m_;
    Node nodes_[kDepth + 2];
    bool plain_ = true;
    std::int64_t samples_ = 0;
    std::size_t alone_ = 0;  // the joint whose d_i has failed; n: the whole matrix
    Test test_{};
    double small_ = 0.0;  // deviations of functions that are bounded all at once
    double angle_ = 0.5 * kPi;
    std::vector<Complex> scale_, rigid_, shapes_, functions_;
    std::vector<double> shapes_real_, shapes_imaginary_, spread_, bends_, law_bends_, missed_, trial_, vector_;

    // Units in which every d_i has size 1 in the middle, and as much of a common phase as is asked for: a congruence.
    void align(double low, double high) {
        const double middle = std::sqrt(low * high);
        Complex mean = 0.0;
        for (std::size_t i = 0; i < n_; i++) {
            scale_[i] = loop_.inverse_law(i, middle);
            mean += scale_[i] / std::abs(scale_[i]);
        }
        plain_ = loop_.pairs() && alignment_ == 0;
        for (std::size_t i = 0; i < n_; i++) {
            const double turn = alignment_ == 0 ? 0.0 : 0.5 * alignment_ * turn_between(scale_[i], mean);
            scale_[i] = std::polar(1 / std::sqrt(std::abs(scale_[i])), turn);
        }
        for (std::size_t k = 0; k < m_; k++)
            for (std::size_t i = 0; i < n_; i++) shapes_[k * n_ + i] = times(scale_[i], loop_.shapes[k * n_ + i]);
        for (std::size_t i = 0; i < n_; i++) {
            spread_[i] = 0.0;
            for (std::size_t j = 0; j < n_; j++) {
                rigid_[i * n_ + j] = times(times(scale_[i], scale_[j]), loop_.rigid[i * n_ + j]);
                spread_[i] += std::abs(rigid_[i * n_ + j]);
            }
        }
        if (mixed()) {
            mix();
            const double most = mixing_size_ * *std::max_element(spread_.begin(), spread_.end());
            std::fill(spread_.begin(), spread_.end(), most);
            plain_ = false;
        }
        // Gershgorin: Σ_k |φ_k φ_kᵀ| + |M₀| lies below this diagonal
        for (std::size_t k = 0; k < m_; k++) {
            double total = 0.0;
            for (std::size_t i = 0; i < n_; i++) total += std::abs(shapes_[k * n_ + i]);
            for (std::size_t i = 0; i < n_; i++) spread_[i] += std::abs(shapes_[k * n_ + i]) * total;
        }
        for (std::size_t k = 0; k < m_ * n_; k++) {
            shapes_real_[k] = shapes_[k].real();
            shapes_imaginary_[k] = shapes_[k].imag();
        }
        small_ = kSmall / *std::max_element(spread_.begin(), spread_.end());
    }

    bool mixed() const { return !crossing_.empty(); }

    // T, and what it makes of the modes.
    void mix() {
        mixing_ = mixing_of(crossing_, scale_, mixing_size_);
        for (std::size_t k = 0; k < m_; k++) {
            for (std::size_t j = 0; j < n_; j++) column_[j] = mixed_row(&shapes_[k * n_], j);
            std::copy(column_.begin(), column_.end(), &shapes_[k * n_]);
        }
        std::vector<Complex> half(n_ * n_);
        for (std::size_t i = 0; i < n_; i++)
            for (std::size_t j = 0; j < n_; j++) half[j * n_ + i] = mixed_row(&rigid_[i * n_], j);  // (M T)ᵀ
        for (std::size_t i = 0; i < n_; i++)
            for (std::size_t j = 0; j < n_; j++) rigid_[j * n_ + i] = mixed_row(&half[i * n_], j);
        law_missed_.assign(n_ * n_, 0.0);
    }

    // Σ_i row_i T_ij
    Complex mixed_row(const Complex* row, std::size_t j) const {
        Complex value = 0.0;
        for (std::size_t i = 0; i < n_; i++) value += times(row[i], mixing_[i * n_ + j]);
        return value;
    }

    void sample(Node& node, double omega) {
        samples_++;
        node.omega = omega;
        Complex f0;
        loop_.functions(omega, f0, functions_.data());
        for (std::size_t i = 0; i < n_; i++)
            for (std::size_t j = i; j < n_; j++) {
                const Complex value = times(rigid_[i * n_ + j], f0);
                node.real[i * n_ + j] = value.real();
                node.imaginary[i * n_ + j] = value.imag();
            }
        for (std::size_t k = 0; k < m_; k++) {
            const double *re = &shapes_real_[k * n_], *im = &shapes_imaginary_[k * n_];
            for (std::size_t i = 0; i < n_; i++) {
                const Complex f = times(functions_[k], {re[i], im[i]});
                add(f.real(), re, &node.real[i * n_], i);
                add(f.imag(), re, &node.imaginary[i * n_], i);
                if (plain_) continue;
                add(-f.imag(), im, &node.real[i * n_], i);
                add(f.real(), im, &node.imaginary[i * n_], i);
            }
        }
        for (std::size_t i = 0; i < n_; i++) {
            const Complex d = loop_.inverse_law(i, omega);
            node.size[i] = ModalLoop::inverse_law_size(d, omega, loop_.step);
            node.law[i] = times(d, times(scale_[i], scale_[i]));
            if (!mixed()) {
                node.real[i * n_ + i] += v_ * node.law[i].real();
                node.imaginary[i * n_ + i] += v_ * node.law[i].imag();
            }
        }
        if (!mixed()) return;
        for (std::size_t i = 0; i < n_; i++)
            for (std::size_t j = i; j < n_; j++) {
                Complex value = 0.0;
                for (std::size_t k = 0; k < n_; k++) value += times(node.law[k], times(mixing_[k * n_ + i], mixing_[k * n_ + j]));
                node.law_real[i * n_ + j] = value.real();
                node.law_imaginary[i * n_ + j] = value.imag();
                node.real[i * n_ + j] += v_ * value.real();
                node.imaginary[i * n_ + j] += v_ * value.imag();
            }
    }

    // What interpolation between two nodes may miss: `missed_` of Q (upper triangle), `law_bends_` of d; of one node only round-off.
    void bound(const Node& left, const Node& right) {
        std::fill(missed_.begin(), missed_.end(), 0.0);
        for (std::size_t i = 0; i < n_; i++)
            missed_[i * n_ + i] = kRounding * static_cast<double>(n_) * (std::abs(left.law[i]) + std::abs(right.law[i]) + spread_[i]);
        std::fill(law_bends_.begin(), law_bends_.end(), 0.0);
        std::fill(law_missed_.begin(), law_missed_.end(), 0.0);
        if (&left == &right) return;
        const Cell cell(left.omega, right.omega, loop_.step, loop_.inexact);
        double f0;
        loop_.bends(cell, f0, bends_.data());
        double common = f0;  // what every term may miss; what larger ones miss beyond is added one by one
        for (const double bend : bends_)
            if (bend <= small_) common = std::max(common, bend);
        for (std::size_t k = 0; k < m_; k++) {
            if (bends_[k] <= common) continue;
            const double *re = &shapes_real_[k * n_], *im = &shapes_imaginary_[k * n_], bend = bends_[k] - common;
            for (std::size_t i = 0; i < n_; i++) {
                add(bend * re[i], re, &missed_[i * n_], i);
                if (!plain_) add(bend * im[i], im, &missed_[i * n_], i);
            }
        }
        for (std::size_t i = 0; i < n_; i++) {
            const double size = std::max(left.size[i], right.size[i]);
            law_bends_[i] = loop_.inverse_law_bend(i, cell, size) * std::norm(scale_[i]);
            missed_[i * n_ + i] += common * spread_[i];
        }
        const double most = mixing_size_ * *std::max_element(law_bends_.begin(), law_bends_.end());
        for (std::size_t i = 0; i < n_; i++) {
            missed_[i * n_ + i] += v_ * (mixed() ? most : law_bends_[i]);
            if (mixed()) law_missed_[i * n_ + i] = most + kRounding * static_cast<double>(n_) * mixing_size_;
        }
    }

    // True where one angle serves both ends, with what interpolation misses to spare.
    bool excluded(const Node& left, const Node& right) {
        bound(left, right);
        double low = angle_ - kPi, high = angle_ + kPi;
        for (int cut = 0; cut < kCuts; cut++) {
            if (!(high - low > 1e-12)) return false;
            if (cut > 0 || !(low < angle_ && angle_ < high)) angle_ = 0.5 * (low + high);
            const Node* failed = nullptr;
            for (const Node* node : {&right, &left}) {
                if (!holds(*node)) {
                    failed = node;
                    break;
                }
            }
            if (failed == nullptr) return true;
            if (!cut_off(*failed, low, high)) return false;
        }
        return false;
    }

    // True where the angle serves one node; else `test_` has failed there, with `vector_` or `alone_` to show it.
    bool holds(const Node& node) {
        alone_ = n_;
        if (mixed()) {
            test_ = {node.law_real.data(), node.law_imaginary.data(), law_missed_.data()};
            if (!positive(test_)) return false;
        } else {
            const double c = std::cos(angle_), s = std::sin(angle_);
            for (std::size_t i = 0; i < n_; i++)
                if (!(c * node.law[i].real() - s * node.law[i].imag() > law_bends_[i])) {
                    alone_ = i;
                    return false;
                }
        }
        test_ = {node.real.data(), node.imaginary.data(), missed_.data()};
        return positive(test_);
    }

    // Cholesky's factorisation; where it fails, `vector_` is an x with xᵀMx <= 0.
    bool positive(const Test& test) {
        const double c = std::cos(angle_), s = std::sin(angle_);
        for (std::size_t k = 0; k < n_; k++)
            for (std::size_t j = k; j < n_; j++) {
                const std::size_t at = k * n_ + j;
                trial_[at] = c * test.real[at] - s * test.imaginary[at] - test.missed[at];
            }
        for (std::size_t k = 0; k < n_; k++) {
            double* row = &trial_[k * n_];
            if (!(row[k] > 0)) {
                std::fill(vector_.begin(), vector_.end(), 0.0);
                vector_[k] = 1.0;
                for (std::size_t i = k; i-- > 0;) {
                    for (std::size_t j = i + 1; j <= k; j++) vector_[i] -= trial_[i * n_ + j] * vector_[j];
                    vector_[i] *= trial_[i * n_ + i];
                }
                return false;
            }
            const double inverse = 1 / std::sqrt(row[k]);
            for (std::size_t j = k + 1; j < n_; j++) row[j] *= inverse;
            for (std::size_t i = k + 1; i < n_; i++) add(-row[i], row, &trial_[i * n_], i);
            row[k] = inverse;  // of the pivot
        }
        return true;
    }

    // to_j += factor from_j for j >= first: rows of upper triangles, which processors add two or four at a time.
    void add(double factor, const double* __restrict from, double* __restrict to, std::size_t first) const {
        for (std::size_t j = first; j < n_; j++) to[j] += factor * from[j];
    }

    // Leaves the angles at which what has failed may hold; false where there is none.
    bool cut_off(const Node& node, double& low, double& high) {
        double cosine = 0.0, sine = 0.0, needed = 0.0;
        if (alone_ < n_) {
            cosine = node.law[alone_].real();
            sine = -node.law[alone_].imag();
            needed = law_bends_[alone_];
        } else {
            for (std::size_t i = 0; i < n_; i++)
                for (std::size_t j = i; j < n_ && vector_[i] != 0; j++) {
                    const double product = (j > i ? 2.0 : 1.0) * vector_[i] * vector_[j];
                    cosine += product * test_.real[i * n_ + j];
                    sine -= product * test_.imaginary[i * n_ + j];
                    needed += product * test_.missed[i * n_ + j];
                }
        }
        const double size = std::hypot(cosine, sine);
        if (!(size > needed)) return false;
        narrow(low, high, std::atan2(sine, cosine), std::acos(std::clamp(needed / size, -1.0, 1.0)));
        return true;
    }

    // (low, high) within `half` of the angle `middle`, the turn of it that is nearest.
    static void narrow(double& low, double& high, double middle, double half) {
        const double near = middle + 2 * kPi * std::round((0.5 * (low + high) - middle) / (2 * kPi));
        low = std::max(low, near - half);
        high = std::min(high, near + half);
    }

    static void add(std::vector<Interval>& to, double low, double high) {
        if (!to.empty() && to.back().high == low)
            to.back().high = high;
        else
            to.push_back({low, high});
    }

};

}  // namespace gainroom
