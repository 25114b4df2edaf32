// Eigenvalues and eigenvectors of small Hermitian matrices, and products of small complex ones.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "complex.hpp"
#include "dense.hpp"

namespace gainroom {

// a b (n, n).
inline void multiply(const Dense& a, const Dense& b, Dense& product) {
    const std::size_t n = a.rows, m = b.columns;
    product.resize(n, m);
    for (std::size_t i = 0; i < n; i++) {
        double *re = &product.re[i * m], *im = &product.im[i * m];
        for (std::size_t k = 0; k < a.columns; k++) {
            const double ar = a.re[i * a.columns + k], ai = a.im[i * a.columns + k];
            const double *br = &b.re[k * m], *bi = &b.im[k * m];
            for (std::size_t j = 0; j < m; j++) {
                re[j] += ar * br[j] - ai * bi[j];
                im[j] += ar * bi[j] + ai * br[j];
            }
        }
    }
}

// aᴴ a (n, n).
inline void gram(const Dense& a, Dense& product) {
    const std::size_t n = a.columns;
    product.resize(n, n);
    for (std::size_t k = 0; k < a.rows; k++) {
        const double *ar = &a.re[k * n], *ai = &a.im[k * n];
        for (std::size_t i = 0; i < n; i++) {
            double *re = &product.re[i * n], *im = &product.im[i * n];
            const double r = ar[i], q = ai[i];
            for (std::size_t j = 0; j < n; j++) {
                re[j] += r * ar[j] + q * ai[j];
                im[j] += r * ai[j] - q * ar[j];
            }
        }
    }
}

// Householder's tridiagonal form, then QL with shifts (Golub and Van Loan, section 8.3).
class Hermitian {
public:
    explicit Hermitian(std::size_t n) : values(n), n_(n), d_(n), e_(n), pr_(n), pi_(n), beta_(n), off_(n), order_(n) {
        vectors.resize(n, n);
    }

    std::vector<double> values;  // falling
    Dense vectors;               // in rows, in the order of the values

    // Of h (n, n), which is destroyed; false where the values do not settle. Vectors where asked for.
    bool find(Dense& h, bool with_vectors) {
        reduce(h);
        if (with_vectors) start(h);
        if (!settle(with_vectors)) return false;
        for (std::size_t k = 0; k < n_; k++) order_[k] = k;
        std::sort(order_.begin(), order_.end(), [&](std::size_t a, std::size_t b) { return d_[a] > d_[b]; });
        for (std::size_t k = 0; k < n_; k++) values[k] = d_[order_[k]];
        if (!with_vectors) return true;
        for (std::size_t k = 0; k < n_; k++) {
            std::copy_n(&basis_.re[order_[k] * n_], n_, &vectors.re[k * n_]);
            std::copy_n(&basis_.im[order_[k] * n_], n_, &vectors.im[k * n_]);
        }
        return true;
    }

private:
    std::size_t n_;
    std::vector<double> d_, e_, pr_, pi_, beta_;
    std::vector<Complex> off_;
    std::vector<std::size_t> order_;
    Dense basis_;  // eigenvectors in rows

    // h → diagonal, complex entries beside it, and in the rows of h from k + 1 on the vectors of the reflections.
    void reduce(Dense& h) {
        const std::size_t n = n_;
        for (std::size_t k = 0; k + 1 < n; k++) {
            // row k right of the diagonal is the conjugate of the column below it
            double *vr = &h.re[k * n], *vi = &h.im[k * n];
            d_[k] = vr[k];
            double tail = 0.0;
            for (std::size_t r = k + 1; r < n; r++) vi[r] = -vi[r];
            for (std::size_t r = k + 2; r < n; r++) tail += vr[r] * vr[r] + vi[r] * vi[r];
            const Complex first(vr[k + 1], vi[k + 1]);
            const double size = std::sqrt(std::norm(first));
            beta_[k] = 0.0;
            off_[k] = first;
            if (!(tail > 0)) continue;
            const double length = std::sqrt(size * size + tail);
            const Complex phase = size > 0 ? first / size : Complex(1.0);
            off_[k] = -phase * length;
            vr[k + 1] = phase.real() * (size + length);
            vi[k + 1] = phase.imag() * (size + length);
            beta_[k] = 2 / (tail + (size + length) * (size + length));
            reflect(h, k, vr, vi);
        }
        if (n > 0) d_[n - 1] = h.re[n * n - 1];
    }

    // h ← (I − β v vᴴ) h (I − β v vᴴ) behind row k: h − v wᴴ − w vᴴ, w = p − (β/2)(vᴴp) v, p = β h v.
    void reflect(Dense& h, std::size_t k, const double* vr, const double* vi) {
        const std::size_t n = n_;
        std::fill(pr_.begin(), pr_.end(), 0.0);
        std::fill(pi_.begin(), pi_.end(), 0.0);
        for (std::size_t c = k + 1; c < n; c++) {
            const double *hr = &h.re[c * n], *hi = &h.im[c * n], a = beta_[k] * vr[c], b = beta_[k] * vi[c];
            for (std::size_t r = k + 1; r < n; r++) {
                pr_[r] += a * hr[r] + b * hi[r];
                pi_[r] += b * hr[r] - a * hi[r];
            }
        }
        double inner = 0.0;
        for (std::size_t r = k + 1; r < n; r++) inner += vr[r] * pr_[r] + vi[r] * pi_[r];
        inner *= 0.5 * beta_[k];
        for (std::size_t r = k + 1; r < n; r++) {
            pr_[r] -= inner * vr[r];
            pi_[r] -= inner * vi[r];
        }
        for (std::size_t r = k + 1; r < n; r++) {
            double *hr = &h.re[r * n], *hi = &h.im[r * n];
            const double a = vr[r], b = vi[r], p = pr_[r], q = pi_[r];
            for (std::size_t c = k + 1; c < n; c++) {
                hr[c] -= a * pr_[c] + b * pi_[c] + p * vr[c] + q * vi[c];
                hi[c] -= b * pr_[c] - a * pi_[c] + q * vr[c] - p * vi[c];
            }
        }
    }

    // The unitary matrix of the reduction with the phases of the entries beside the diagonal, its columns as rows.
    void start(const Dense& h) {
        const std::size_t n = n_;
        basis_.resize(n, n);
        Complex phase = 1.0;
        for (std::size_t k = 0; k < n; k++) {
            basis_.set(k, k, phase);
            const double size = k + 1 < n ? std::sqrt(std::norm(off_[k])) : 0.0;
            if (size > 0) phase = times(phase, off_[k] / size);
        }
        for (std::size_t k = n - 1; k-- > 0;) {
            if (beta_[k] == 0) continue;
            const double *vr = &h.re[k * n], *vi = &h.im[k * n];
            for (std::size_t c = k + 1; c < n; c++) {
                double *yr = &basis_.re[c * n], *yi = &basis_.im[c * n], re = 0.0, im = 0.0;
                for (std::size_t r = k + 1; r < n; r++) {
                    re += vr[r] * yr[r] + vi[r] * yi[r];
                    im += vr[r] * yi[r] - vi[r] * yr[r];
                }
                re *= beta_[k];
                im *= beta_[k];
                for (std::size_t r = k + 1; r < n; r++) {
                    yr[r] -= re * vr[r] - im * vi[r];
                    yi[r] -= re * vi[r] + im * vr[r];
                }
            }
        }
    }

    bool settle(bool with_vectors) {
        const std::size_t n = n_;
        double largest = 0.0;
        for (std::size_t k = 0; k < n; k++) {
            e_[k] = k + 1 < n ? std::sqrt(std::norm(off_[k])) : 0.0;
            largest = std::max({largest, std::fabs(d_[k]), e_[k]});
        }
        if (!std::isfinite(largest)) return false;
        for (std::size_t low = 0; low < n; low++)
            for (int round = 0;; round++) {
                std::size_t end = low;
                while (end + 1 < n && std::fabs(e_[end]) > 1e-16 * (std::fabs(d_[end]) + std::fabs(d_[end + 1])) + 1e-17 * largest) end++;
                if (end == low) break;
                if (round > 60) return false;
                step(low, end, with_vectors);
            }
        return true;
    }

    void step(std::size_t low, std::size_t end, bool with_vectors) {
        double g = (d_[low + 1] - d_[low]) / (2 * e_[low]), r = std::sqrt(g * g + 1);
        g = d_[end] - d_[low] + e_[low] / (g + std::copysign(r, g));
        double s = 1.0, c = 1.0, p = 0.0;
        for (std::size_t k = end; k-- > low;) {
            const double f = s * e_[k], b = c * e_[k];
            e_[k + 1] = r = std::sqrt(f * f + g * g);
            if (r == 0) {
                d_[k + 1] -= p;
                e_[end] = 0.0;
                return;
            }
            s = f / r;
            c = g / r;
            g = d_[k + 1] - p;
            r = (d_[k] - g) * s + 2 * c * b;
            p = s * r;
            d_[k + 1] = g + p;
            g = c * r - b;
            if (with_vectors) {
                turn(&basis_.re[k * n_], &basis_.re[(k + 1) * n_], c, s);
                turn(&basis_.im[k * n_], &basis_.im[(k + 1) * n_], c, s);
            }
        }
        d_[low] -= p;
        e_[low] = g;
        e_[end] = 0.0;
    }

    void turn(double* first, double* second, double c, double s) const {
        for (std::size_t r = 0; r < n_; r++) {
            const double kept = second[r];
            second[r] = s * first[r] + c * kept;
            first[r] = c * first[r] - s * kept;
        }
    }
};

}  // namespace gainroom
