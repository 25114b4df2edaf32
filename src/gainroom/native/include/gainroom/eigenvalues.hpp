// Eigenvalues of small dense complex matrices.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>

#include "block.hpp"
#include "complex.hpp"

namespace gainroom {

// Hessenberg form by elimination, then LR with shifts and exchanges, which takes a third of QR's products (Martin and Wilkinson 1968). It
// may lose digits where QR does not: sums of eigenvalues and of their squares tell, and then QR follows (Golub and Van Loan, section 7.5).
class Eigenvalues {
public:
    // All memory for matrices up to (n, n).
    void reserve(std::size_t n) {
        for (auto* one : {&re_, &im_, &form_re_, &form_im_}) one->reserve(n * n);
        for (auto* one : {&factor_re_, &factor_im_}) one->reserve(n);
        for (auto* one : {&cosine_, &sine_}) one->reserve(n);
        exchanged_.reserve(n);
    }

    // Of a (n, n) by rows, its real and imaginary parts apart. False where they do not settle, or an entry is not finite.
    bool find(const double* re, const double* im, std::size_t n, Complex* values) {
        n_ = n;
        double most = 0.0;
        for (std::size_t k = 0; k < n * n; k++) {
            const double own = std::fabs(re[k]) + std::fabs(im[k]);
            if (!std::isfinite(own)) return false;
            most = std::max(most, own);
        }
        if (most == 0) {
            std::fill(values, values + n, Complex(0.0));
            return true;
        }
        re_.resize(n * n);
        im_.resize(n * n);
        for (std::size_t k = 0; k < n * n; k++) {  // so that no square leaves the range
            re_[k] = re[k] / most;
            im_[k] = im[k] / most;
        }
        Complex sum = 0.0, squares = 0.0;
        for (std::size_t r = 0; r < n; r++) {
            sum += entry(r, r);
            for (std::size_t c = 0; c < n; c++) squares += times(entry(r, c), entry(c, r));
        }
        reduce();
        form_re_ = re_;
        form_im_ = im_;
        bool found = settled(values, false);
        for (std::size_t k = 0; found && k < n; k++) {
            sum -= values[k];
            squares -= times(values[k], values[k]);
        }
        if (!found || !(size(sum) + size(squares) < kAgree)) {
            re_ = form_re_;
            im_ = form_im_;
            found = settled(values, true);
        }
        for (std::size_t k = 0; k < n; k++) {
            values[k] *= most;
            found = found && std::isfinite(size(values[k]));
        }
        return found;
    }

    bool find(const Complex* a, std::size_t n, Complex* values) {
        Vector<double> re(n * n), im(n * n);
        for (std::size_t k = 0; k < n * n; k++) {
            re[k] = a[k].real();
            im[k] = a[k].imag();
        }
        return find(re.data(), im.data(), n, values);
    }

private:
    static constexpr double kAgree = 1e-12;  // of the largest entry

    bool settled(Complex* values, bool unitary) {
        std::size_t high = n_;
        for (int round = 0; high > 0;) {
            const std::size_t low = start_of_block(high);
            if (low + 1 == high) {
                values[--high] = entry(low, low);
                round = 0;
                continue;
            }
            if (++round > 90) return false;
            const Complex own = shift(high, round);
            if (unitary) step(low, high, own);
            else eliminate(low, high, own);
        }
        return true;
    }

    // H − shift = L R with exchanges of rows, then R L + shift.
    GAINROOM_WIDE void eliminate(std::size_t low, std::size_t high, Complex shift) {
        factor_re_.resize(n_);
        factor_im_.resize(n_);
        exchanged_.clear();
        for (std::size_t k = low; k < high; k++) set(k, k, entry(k, k) - shift);
        for (std::size_t k = low; k + 1 < high; k++) {
            double *__restrict upper_re = &re_[k * n_], *__restrict upper_im = &im_[k * n_];
            double *__restrict lower_re = upper_re + n_, *__restrict lower_im = upper_im + n_;
            if (size({lower_re[k], lower_im[k]}) > size({upper_re[k], upper_im[k]})) {
                exchanged_.push_back(k);
                std::swap_ranges(upper_re + k, upper_re + high, lower_re + k);
                std::swap_ranges(upper_im + k, upper_im + high, lower_im + k);
            }
            const Complex upper(upper_re[k], upper_im[k]), factor = upper == 0.0 ? Complex(0.0) : over({lower_re[k], lower_im[k]}, upper);
            const double x = factor_re_[k] = factor.real(), y = factor_im_[k] = factor.imag();
            lower_re[k] = lower_im[k] = 0.0;
            for (std::size_t c = k + 1; c < high; c++) {
                lower_re[c] -= x * upper_re[c] - y * upper_im[c];
                lower_im[c] -= x * upper_im[c] + y * upper_re[c];
            }
        }
        const double *x = factor_re_.data(), *y = factor_im_.data();
        for (std::size_t r = low; r < high; r++) {  // R L, row by row, from one exchange to the next
            double *re = &re_[r * n_], *im = &im_[r * n_];
            std::size_t first = r > low ? r - 1 : low;
            auto next = std::lower_bound(exchanged_.begin(), exchanged_.end(), first);
            while (first + 1 < high) {
                const std::size_t end = next != exchanged_.end() ? *next : high - 1;
                add_next(re, im, x, y, first, end);
                if (next == exchanged_.end()) break;
                std::swap(re[end], re[end + 1]);
                std::swap(im[end], im[end + 1]);
                add_next(re, im, x, y, end, end + 1);
                first = end + 1;
                next++;
            }
        }
        for (std::size_t k = low; k < high; k++) set(k, k, entry(k, k) + shift);
    }

    // Entries `first` to `end` of a row: each takes its factor times the next one's value before.
    static inline void add_next(double* re, double* im, const double* x, const double* y, std::size_t first, std::size_t end) {
        for (std::size_t k = first; k < end; k++) {
            const double a = re[k + 1], b = im[k + 1];
            re[k] += x[k] * a - y[k] * b;
            im[k] += x[k] * b + y[k] * a;
        }
    }

    Complex entry(std::size_t r, std::size_t c) const { return {re_[r * n_ + c], im_[r * n_ + c]}; }
    void set(std::size_t r, std::size_t c, Complex value) {
        re_[r * n_ + c] = value.real();
        im_[r * n_ + c] = value.imag();
    }
    static double size(Complex a) { return std::fabs(a.real()) + std::fabs(a.imag()); }

    GAINROOM_WIDE void reduce() {
        for (std::size_t m = 1; m + 1 < n_; m++) {
            std::size_t row = m;
            for (std::size_t r = m + 1; r < n_; r++)
                if (size(entry(r, m - 1)) > size(entry(row, m - 1))) row = r;
            if (size(entry(row, m - 1)) == 0) continue;
            if (row != m) {
                for (auto* part : {&re_, &im_}) {
                    double* a = part->data();
                    std::swap_ranges(a + row * n_ + m - 1, a + row * n_ + n_, a + m * n_ + m - 1);
                    for (std::size_t r = 0; r < n_; r++) std::swap(a[r * n_ + row], a[r * n_ + m]);
                }
            }
            const Complex inverse = over(1.0, entry(m, m - 1));
            const double *from_re = &re_[m * n_], *from_im = &im_[m * n_];
            factor_re_.assign(n_, 0.0);
            factor_im_.assign(n_, 0.0);
            for (std::size_t r = m + 1; r < n_; r++) {
                if (size(entry(r, m - 1)) == 0) continue;
                const Complex factor = times(entry(r, m - 1), inverse);
                const double x = factor_re_[r] = factor.real(), y = factor_im_[r] = factor.imag();
                set(r, m - 1, 0.0);
                double *__restrict to_re = &re_[r * n_], *__restrict to_im = &im_[r * n_];
                for (std::size_t c = m; c < n_; c++) {
                    to_re[c] -= x * from_re[c] - y * from_im[c];
                    to_im[c] -= x * from_im[c] + y * from_re[c];
                }
            }
            for (std::size_t k = 0; k < n_; k++) {  // column m takes the others, each times its factor
                const double *re = &re_[k * n_], *im = &im_[k * n_];
                double a = re[m], b = im[m];
                for (std::size_t r = m + 1; r < n_; r++) {
                    a += factor_re_[r] * re[r] - factor_im_[r] * im[r];
                    b += factor_re_[r] * im[r] + factor_im_[r] * re[r];
                }
                re_[k * n_ + m] = a;
                im_[k * n_ + m] = b;
            }
        }
    }

    std::size_t start_of_block(std::size_t high) {
        for (std::size_t low = high - 1; low > 0; low--) {
            double beside = size(entry(low - 1, low - 1)) + size(entry(low, low));
            if (beside == 0) beside = 1e-300;
            if (size(entry(low, low - 1)) <= 2.3e-16 * beside) {
                set(low, low - 1, 0.0);
                return low;
            }
        }
        return 0;
    }

    // The eigenvalue of the last two rows that is nearer to the last entry; now and then something else, as a cycle is possible.
    Complex shift(std::size_t high, int round) {
        const Complex a = entry(high - 2, high - 2), b = entry(high - 2, high - 1), c = entry(high - 1, high - 2), d = entry(high - 1, high - 1);
        if (round % 15 == 0) return d + size(c);
        const Complex half = 0.5 * (a - d), root = std::sqrt(times(half, half) + times(b, c));
        const Complex larger = std::norm(half + root) > std::norm(half - root) ? half + root : half - root;
        return larger == 0.0 ? d : d - over(times(b, c), larger);
    }

    void step(std::size_t low, std::size_t high, Complex shift) {
        cosine_.resize(n_);
        sine_.resize(n_);
        for (std::size_t k = low; k < high; k++) set(k, k, entry(k, k) - shift);
        for (std::size_t k = low; k + 1 < high; k++) {
            const Complex a = entry(k, k), b = entry(k + 1, k);
            const double length = std::sqrt(std::norm(a) + std::norm(b));
            const Complex c = length > 0 ? a / length : Complex(1.0), s = length > 0 ? b / length : Complex(0.0);
            cosine_[k] = c;
            sine_[k] = s;
            for (std::size_t j = k; j < high; j++) {
                const Complex upper = entry(k, j), lower = entry(k + 1, j);
                set(k, j, times(std::conj(c), upper) + times(std::conj(s), lower));
                set(k + 1, j, times(c, lower) - times(s, upper));
            }
        }
        for (std::size_t k = low; k + 1 < high; k++) {
            const Complex c = cosine_[k], s = sine_[k];
            for (std::size_t r = low; r < std::min(k + 2, high); r++) {
                const Complex left = entry(r, k), right = entry(r, k + 1);
                set(r, k, times(left, c) + times(right, s));
                set(r, k + 1, times(right, std::conj(c)) - times(left, std::conj(s)));
            }
        }
        for (std::size_t k = low; k < high; k++) set(k, k, entry(k, k) + shift);
    }

    std::size_t n_ = 0;
    Vector<double> re_, im_, form_re_, form_im_, factor_re_, factor_im_;
    Vector<Complex> cosine_, sine_;
    Vector<std::size_t> exchanged_;
};

}  // namespace gainroom
