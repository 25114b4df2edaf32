// The matrix M (r, r) of which task_loop.hpp has det(I + g M): what tasks' gains make of the joints' mobility at jω, and its slope.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include "dense.hpp"
#include "joint_law.hpp"
#include "symmetric_factor.hpp"

namespace gainroom {

// For postures as TaskLoop has them. For one thread at a time.
class TaskMatrix {
public:
    TaskMatrix(const JointData* joints, std::size_t count, double sample_time, std::size_t rank)
        : laws_(joints, count, sample_time), alike_(laws_.alike_drives()), size_(count), rank_(rank), factor_(count), values_(count) {
        for (Dense* one : {&seen_, &seen_omega_, &loop_, &loop_omega_}) one->resize(rank, rank);
        for (Dense* one : {&left_, &right_}) one->resize(count, rank);
        for (Dense* one : {&mobility_, &by_row_, &by_mode_}) one->resize(1, rank);
    }

    const JointLaws& laws() const { return laws_; }
    // Whether all commands reach their motors in the same way.
    bool alike() const { return alike_; }
    // Where `evaluate` was last: M and dM/dω.
    const Dense& at() const { return loop_; }
    const Dense& slope() const { return loop_omega_; }

    // δ.
    Complex delta(double omega) const {
        const double step = laws_.sample_time();
        return step > 0.0 ? (1.0 - Complex(std::cos(omega * step), -std::sin(omega * step))) / step : Complex(0.0, omega);
    }

    // M, and with `slopes` dM/dω. Ranks of one, two and four tasks of three directions, and of three, are known to the compiler: rows of six
    // numbers are not worth a loop.
    GAINROOM_WIDE void evaluate(const double* posture, double omega, bool slopes) {
        switch (rank_) {
            case 3: return evaluate_as<3>(posture, omega, slopes);
            case 6: return evaluate_as<6>(posture, omega, slopes);
            case 9: return evaluate_as<9>(posture, omega, slopes);
            case 12: return evaluate_as<12>(posture, omega, slopes);
            default: return evaluate_as<0>(posture, omega, slopes);
        }
    }

private:
    template <std::size_t Rank>
    void evaluate_as(const double* posture, double omega, bool slopes) {
        const std::size_t n = size_, r = Rank ? Rank : rank_;
        const double* q = posture + n * n;
        laws_.open(omega, values_.data());
        factor_.factor(posture, values_.data());
        spread<Rank>(q, left_, false);
        const Dense& right = alike_ ? left_ : right_;
        if (slopes && !alike_) spread<Rank>(q, right_, true);
        for (Dense* one : {&seen_, &seen_omega_, &loop_, &loop_omega_}) {
            std::fill(one->re.begin(), one->re.end(), 0.0);
            std::fill(one->im.begin(), one->im.end(), 0.0);
        }
        // Drives that are alike scale the mobility of the whole.
        const OpenValue& one = values_[0];
        for (std::size_t i = 0; i < n; i++) {
            const OpenValue& value = values_[i];
            const double *row = q + i * r, *vr = &left_.re[i * r], *vi = &left_.im[i * r];
            const Complex outward = over(1.0, value.outer), p = times(times(value.outer_omega, outward), outward);
            combine<Rank>(row, vr, vi, value.through, -outward, mobility_);
            if (!alike_) scale(mobility_, value.drive);
            if (!alike_ && value.alias != 0.0) combine<Rank>(row, nullptr, nullptr, value.alias, 0.0, mobility_, true);
            for (std::size_t k = 0; k < r; k++) add<Rank>(seen_, k, mobility_.at(0, k), row);
            if (!slopes) continue;
            combine<Rank>(row, vr, vi, value.through_omega, p, by_row_);
            if (!alike_) {
                scale(by_row_, value.drive);
                combine<Rank>(row, vr, vi, times(value.through, value.drive_omega) + value.alias_omega, -times(outward, value.drive_omega), by_row_, true);
            }
            combine<Rank>(row, vr, vi, p, value.beta_omega, by_mode_);
            const double *ur = &right.re[i * r], *ui = &right.im[i * r];
            for (std::size_t k = 0; k < r; k++) {
                const double ar = by_row_.re[k], ai = by_row_.im[k], br = by_mode_.re[k], bi = by_mode_.im[k];
                double *re = &seen_omega_.re[k * r], *im = &seen_omega_.im[k * r];
                for (std::size_t l = 0; l < r; l++) {
                    re[l] += ar * row[l] + (br * ur[l] - bi * ui[l]);
                    im[l] += ai * row[l] + (br * ui[l] + bi * ur[l]);
                }
            }
        }
        if (alike_) drive_all<Rank>(one, q, slopes);
        close<Rank>(q + n * r, omega, slopes);
    }

    // The mobility that every command reaches in the same way, driven, and what aliases add.
    template <std::size_t Rank>
    void drive_all(const OpenValue& drive, const double* q, bool slopes) {
        const std::size_t r = Rank ? Rank : rank_;
        for (std::size_t k = 0; k < r * r; k++) {
            const Complex seen(seen_.re[k], seen_.im[k]), driven = times(seen, drive.drive);
            seen_.re[k] = driven.real();
            seen_.im[k] = driven.imag();
            if (!slopes) continue;
            const Complex turned = times({seen_omega_.re[k], seen_omega_.im[k]}, drive.drive) + times(seen, drive.drive_omega);
            seen_omega_.re[k] = turned.real();
            seen_omega_.im[k] = turned.imag();
        }
        if (laws_.sample_time() == 0.0) return;
        for (std::size_t i = 0; i < size_; i++)
            for (std::size_t k = 0; k < r; k++) {
                add<Rank>(seen_, k, q[i * r + k] * values_[i].alias, q + i * r);
                if (slopes) add<Rank>(seen_omega_, k, q[i * r + k] * values_[i].alias_omega, q + i * r);
            }
    }

    // `to` becomes, or grows by, a row times a, real, and one times b, complex.
    template <std::size_t Rank>
    void combine(const double* row, const double* re, const double* im, Complex a, Complex b, Dense& to, bool more = false) const {
        for (std::size_t k = 0; k < (Rank ? Rank : rank_); k++) {
            double x = a.real() * row[k], y = a.imag() * row[k];
            if (re) {
                x += b.real() * re[k] - b.imag() * im[k];
                y += b.real() * im[k] + b.imag() * re[k];
            }
            to.re[k] = more ? to.re[k] + x : x;
            to.im[k] = more ? to.im[k] + y : y;
        }
    }
    static void scale(Dense& row, Complex factor) { row.scale(0, factor, 0); }

    // Solutions of (W + diag β) V = diag(1/outer) Q, or with diag(h) Q in place of Q.
    template <std::size_t Rank>
    void spread(const double* q, Dense& found, bool driven) const {
        for (std::size_t i = 0; i < size_; i++) {
            Complex scale = over(1.0, values_[i].outer);
            if (driven) scale = times(scale, values_[i].drive);
            for (std::size_t k = i * rank_; k < (i + 1) * rank_; k++) {
                found.re[k] = scale.real() * q[k];
                found.im[k] = scale.imag() * q[k];
            }
        }
        factor_.solve<Rank>(found.re.data(), found.im.data(), rank_);
    }

    // Row k of `to` grows by `factor` times a real row.
    template <std::size_t Rank = 0>
    static void add(Dense& to, std::size_t k, Complex factor, const double* row) {
        const std::size_t r = Rank ? Rank : to.columns;
        double *re = &to.re[k * r], *im = &to.im[k * r];
        for (std::size_t l = 0; l < r; l++) {
            re[l] += factor.real() * row[l];
            im[l] += factor.imag() * row[l];
        }
    }

    // M = S (R_p + δ R_v) and its slope, from S.
    template <std::size_t Rank>
    void close(const double* gains, double omega, bool slopes) {
        const std::size_t r = Rank ? Rank : rank_;
        const double step = laws_.sample_time();
        const Complex rate = delta(omega), rate_omega = times(Complex(0.0, 1.0), 1.0 - step * rate);
        for (std::size_t k = 0; k < r; k++)
            for (std::size_t m = 0; m < r; m++) {
                const Complex seen = seen_.at(k, m), damped = times(seen, rate);
                add<Rank>(loop_, k, seen, gains + m * r);
                add<Rank>(loop_, k, damped, gains + (r + m) * r);
                if (!slopes) continue;
                const Complex turned = seen_omega_.at(k, m);
                add<Rank>(loop_omega_, k, turned, gains + m * r);
                add<Rank>(loop_omega_, k, times(turned, rate) + times(seen, rate_omega), gains + (r + m) * r);
            }
    }

    JointLaws laws_;
    bool alike_;
    std::size_t size_, rank_;
    SymmetricFactor factor_;
    std::vector<OpenValue> values_;
    Dense left_, right_, mobility_, by_row_, by_mode_;
    Dense seen_, seen_omega_, loop_, loop_omega_;
};

}  // namespace gainroom
