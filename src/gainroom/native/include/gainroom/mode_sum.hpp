// x P = M₀ f₀ + Σ_k φ_k φ_kᵀ f_k of a ModalLoop at many ω, in units of the joints or mixed coordinates that are given once.
//
// Where poles stand alone they come in conjugate pairs, whose φ are conjugate in real units. With φ = a + jb and S = f + f', D = j (f − f'),
//
//   φ φᵀ f + φ̄ φ̄ᵀ f' = (a aᵀ − b bᵀ) S + (a bᵀ + b aᵀ) D;
//
// one with a real φ has b = 0 and S = f, any other S = f, D = jf. Matrices are upper triangles in rows of `stride`, whole fours, of which what is
// below the diagonal is not to be read: sums over all terms are taken four or eight entries at a time, as processors do.
#pragma once

#include <algorithm>
#include <vector>

#include "four.hpp"
#include "modal_loop.hpp"

namespace gainroom {

class ModeSum {
   public:
    const std::size_t size, stride;

    explicit ModeSum(const ModalLoop& loop) : size(loop.size), stride(fours(loop.size)), loop_(loop) {
        rigid_real_.resize(size * stride);
        rigid_imaginary_.resize(size * stride);
        made_of_.resize(loop.modes * stride);
        functions_.resize(loop.modes);
        for (auto* part : {&a_, &b_, &share_}) part->resize(loop.modes * stride);
        moving_.resize(loop.modes);
        for (auto* part : {&s_, &d_}) part->resize(loop.modes);
        bends_.resize(loop.modes);
        alone_.resize(size);
        twin_.resize(loop.modes);
        for (std::size_t k = 0; k < loop.modes; k++) twin_[k] = has_twin(k);
    }

    // Real units of the joints.
    void set_units(const std::vector<double>& units) {
        begin(true);
        for (std::size_t i = 0; i < size; i++)
            for (std::size_t j = 0; j < size; j++) {
                rigid_real_[i * stride + j] = units[i] * units[j] * loop_.rigid_at(i * size + j).real();
                rigid_imaginary_[i * stride + j] = units[i] * units[j] * loop_.rigid_at(i * size + j).imag();
            }
        for (std::size_t k = 0; k < loop_.modes; k++) {
            if (k > 0 && twin_[k - 1]) continue;
            for (std::size_t i = 0; i < size; i++) {
                const Complex value = loop_.shapes[k * size + i] * units[i];
                a_[terms_ * stride + i] = value.real();
                b_[terms_ * stride + i] = value.imag();
            }
            add_term(k);
        }
        finish(false);
        rigid_made_of_ = rigid_spread_;
        made_of_ = share_;
    }

    // Any coordinates: M₀ (n, n) and φ (modes, n) in them; `rigid_made_of` (n) and `made_of` (modes, n), the sizes of what each row of M₀ and
    // each φ is summed up from.
    void set_coordinates(const std::vector<Complex>& rigid, const std::vector<Complex>& shapes, const std::vector<double>& rigid_made_of,
                         const std::vector<double>& made_of) {
        begin(false);
        for (std::size_t i = 0; i < size; i++)
            for (std::size_t j = 0; j < size; j++) {
                rigid_real_[i * stride + j] = rigid[i * size + j].real();
                rigid_imaginary_[i * stride + j] = rigid[i * size + j].imag();
            }
        for (std::size_t k = 0; k < loop_.modes; k++) {
            for (std::size_t i = 0; i < size; i++) {
                a_[terms_ * stride + i] = shapes[k * size + i].real();
                b_[terms_ * stride + i] = shapes[k * size + i].imag();
            }
            add_term(k);
        }
        finish(true);
        rigid_made_of_ = rigid_made_of;
        for (std::size_t t = 0; t < terms_; t++) {
            double total = 0.0;
            for (std::size_t i = 0; i < size; i++) total += made_of[t * size + i];
            for (std::size_t i = 0; i < size; i++) made_of_[t * stride + i] = made_of[t * size + i] * total;
        }
    }

    // Q at ω, its upper triangle; `round_off` (n): what lies above the round-off in it, as a diagonal matrix.
    void respond(double omega, double* real, double* imaginary, double* round_off) {
        const Complex f0 = respond({0.0, omega}, real, imaginary);
        for (std::size_t t = 0; t < terms_; t++)
            bends_[t] = size_of(functions_[first_[t]]) + (second(t) ? size_of(functions_[first_[t] + 1]) : 0.0);
        const double rigid = size_of(f0);
        for (std::size_t i = 0; i < size; i++) round_off[i] = kSums * rigid_made_of_[i] * rigid;
        for (std::size_t t = 0; t < terms_; t++)
            for (std::size_t i = 0; i < size; i++) round_off[i] += kFunctions * made_of_[t * stride + i] * bends_[t];
        for (std::size_t i = 0; i < size; i++) round_off[i] *= static_cast<double>(size);
    }

    // The functions at an s about jω, without round-off; f₀ there.
    GAINROOM_WIDE Complex respond(Complex s, double* real, double* imaginary) {
        Complex f0;
        loop_.functions(s.imag(), f0, functions_.data(), s.real() / s.imag());
        for (std::size_t t = 0; t < terms_; t++) {
            const Complex f = functions_[first_[t]];
            const Complex other = second(t) ? functions_[first_[t] + 1] : 0.0;
            s_[t] = f + other;
            d_[t] = times({0.0, 1.0}, f - other);
        }
        for (std::size_t i = 0; i < size; i++) {
            std::size_t count = 0;
            for (std::size_t t = 0; t < terms_; t++) {
                const double a = a_[t * stride + i], b = b_[t * stride + i];
                if (a == 0 && b == 0) continue;  // modes of other limbs, where those do not feel each other
                const Complex p = s_[t] * a + d_[t] * b, q = d_[t] * a - s_[t] * b;
                moving_[count++] = {t * stride, p.real(), p.imag(), q.real(), q.imag()};
            }
            std::size_t first = i / 4 * 4;
            for (; first + 8 <= stride; first += 8) add<2>(i * stride, first, count, f0, real, imaginary);
            if (first < stride) add<1>(i * stride, first, count, f0, real, imaginary);
        }
        return f0;
    }

    // A matrix (upper triangle) that lies above what interpolation over a cell may miss of Q; terms that may miss little, on its diagonal.
    GAINROOM_WIDE void missed(const Cell& cell, double* out) {
        double f0;
        loop_.bends(cell, f0, bends_.data());
        std::fill(out, out + size * stride, 0.0);
        for (std::size_t i = 0; i < size; i++) alone_[i] = f0 * rigid_spread_[i];
        std::size_t large = 0;
        for (std::size_t t = 0; t < terms_; t++) {
            const double misses = bend(t);
            if (misses * largest_share_[t] > kSmall)
                large_[large++] = {t, misses};
            else
                for (std::size_t i = 0; i < size; i++) alone_[i] += misses * share_[t * stride + i];
        }
        for (std::size_t i = 0; i < size; i++) {
            out[i * stride + i] = alone_[i];
            std::size_t count = 0;
            for (std::size_t l = 0; l < large; l++) {
                const std::size_t at = large_[l].term * stride;
                if (a_[at + i] == 0 && b_[at + i] == 0) continue;
                moving_[count++] = {at, large_[l].misses * a_[at + i], 0.0, large_[l].misses * b_[at + i], 0.0};
            }
            std::size_t first = i / 4 * 4;
            for (; first + 8 <= stride && count > 0; first += 8) add_missed<2>(out + i * stride, first, count);
            if (first < stride && count > 0) add_missed<1>(out + i * stride, first, count);
        }
    }

    // (n) the same of every row: Σ_j of what interpolation may miss of Q_ij.
    void missed_rows(const Cell& cell, double* out) {
        double f0;
        loop_.bends(cell, f0, bends_.data());
        for (std::size_t i = 0; i < size; i++) out[i] = f0 * rigid_spread_[i];
        for (std::size_t t = 0; t < terms_; t++)
            for (std::size_t i = 0; i < size; i++) out[i] += bend(t) * share_[t * stride + i];
    }

   private:
    static constexpr double kSmall = 1e-3;
    static constexpr double kSums = 4e-15, kFunctions = 1e-12;  // relative round-off of sums, and of functions of ω

    const ModalLoop& loop_;
    std::vector<double> rigid_real_, rigid_imaginary_, rigid_spread_, rigid_made_of_, made_of_;
    std::vector<double> a_, b_, share_, largest_share_;  // φ = a + jb (terms, stride); row sums of |φ φᵀ|
    std::vector<double> bends_;
    std::vector<Complex> functions_, s_, d_;
    struct Moving {
        std::size_t at;  // where its φ begins
        double p_re, p_im, q_re, q_im;
    };
    std::vector<Moving> moving_;  // terms of a row that are not 0
    struct Large {
        std::size_t term;
        double misses;
    };
    std::vector<Large> large_;
    std::vector<double> alone_;       // what may be missed of a row, on its diagonal
    std::vector<std::size_t> first_;  // f's of each term: this one, and the next where it has a twin
    std::vector<bool> twin_;
    std::size_t terms_ = 0;
    bool real_ = true, paired_ = true;

    bool has_twin(std::size_t k) const {
        if (loop_.pairs() || k + 1 >= loop_.modes || (k > 0 && twin_[k - 1]) || loop_.poles[k + 1] != std::conj(loop_.poles[k])) return false;
        for (std::size_t i = 0; i < size; i++)
            if (loop_.shapes[(k + 1) * size + i] != std::conj(loop_.shapes[k * size + i])) return false;
        return true;
    }

    bool second(std::size_t t) const { return paired_ && twin_[first_[t]]; }

    double bend(std::size_t t) const { return bends_[first_[t]] + (second(t) ? bends_[first_[t] + 1] : 0.0); }

    void begin(bool paired) {
        paired_ = paired;
        terms_ = 0;
        first_.clear();
        std::fill(rigid_imaginary_.begin(), rigid_imaginary_.end(), 0.0);
    }

    void add_term(std::size_t k) {
        first_.push_back(k);
        terms_++;
    }

    void finish(bool complex) {
        real_ = !complex && loop_.pairs() && !loop_.twofold;
        large_.resize(terms_);
        largest_share_.assign(terms_, 0.0);
        rigid_spread_.assign(size, 0.0);
        for (std::size_t i = 0; i < size; i++)
            for (std::size_t j = 0; j < size; j++)
                rigid_spread_[i] += size_of({rigid_real_[i * stride + j], rigid_imaginary_[i * stride + j]});
        for (std::size_t t = 0; t < terms_; t++) {
            double total = 0.0;
            for (std::size_t i = 0; i < size; i++) total += share_[t * stride + i] = size_of({a_[t * stride + i], b_[t * stride + i]});
            for (std::size_t i = 0; i < size; i++) {
                share_[t * stride + i] *= total;
                largest_share_[t] = std::max(largest_share_[t], share_[t * stride + i]);
            }
        }
    }

    // To a row, from entry `first` on, what may be missed of the first `count` that move it.
    template <std::size_t kFours>
    GAINROOM_INLINE void add_missed(double* row, std::size_t first, std::size_t count) const {
        const double nothing[4] = {};
        Four sum[kFours];
        for (std::size_t m = 0; m < kFours; m++) sum[m] = four(nothing);
        for (std::size_t t = 0; t < count; t++)
            for (std::size_t m = 0; m < kFours; m++) {
                const std::size_t at = moving_[t].at + first + 4 * m;
                sum[m] += moving_[t].p_re * four(&a_[at]) + moving_[t].q_re * four(&b_[at]);
            }
        for (std::size_t m = 0; m < kFours; m++) put(row + first + 4 * m, four(row + first + 4 * m) + sum[m]);
    }

    // Entries from `first` on of the row that begins at `row`, `kFours` times four: of M₀, and of the first `count` that move it.
    template <std::size_t kFours>
    GAINROOM_INLINE void add(std::size_t row, std::size_t first, std::size_t count, Complex f0, double* real, double* imaginary) const {
        Four re[kFours], im[kFours];
        for (std::size_t m = 0; m < kFours; m++) {
            const Four x = four(&rigid_real_[row + first + 4 * m]), y = four(&rigid_imaginary_[row + first + 4 * m]);
            re[m] = f0.real() * x - f0.imag() * y;
            im[m] = f0.imag() * x + f0.real() * y;
        }
        const Moving* const moving = moving_.data();
        const double *all_a = a_.data() + first, *all_b = b_.data() + first;
        if (real_) {
            for (std::size_t t = 0; t < count; t++)
                for (std::size_t m = 0; m < kFours; m++) {
                    const Four a = four(all_a + moving[t].at + 4 * m);
                    re[m] += moving[t].p_re * a;
                    im[m] += moving[t].p_im * a;
                }
        } else {
            for (std::size_t t = 0; t < count; t++)
                for (std::size_t m = 0; m < kFours; m++) {
                    const Four a = four(all_a + moving[t].at + 4 * m), b = four(all_b + moving[t].at + 4 * m);
                    re[m] += moving[t].p_re * a + moving[t].q_re * b;
                    im[m] += moving[t].p_im * a + moving[t].q_im * b;
                }
        }
        for (std::size_t m = 0; m < kFours; m++) {
            put(real + row + first + 4 * m, re[m]);
            put(imaginary + row + first + 4 * m, im[m]);
        }
    }
};

}  // namespace gainroom
