// The matrix M (r, r) of which task_loop.hpp has det(I + g M): what tasks' gains make of the joints' mobility at jω, and its slope.
#pragma once

#include <algorithm>
#include <cstddef>

#include "block.hpp"
#include "dense.hpp"
#include "joint_law.hpp"
#include "symmetric_factor.hpp"

namespace gainroom {

// For postures as TaskLoop has them. For one thread at a time.
class TaskMatrix {
public:
    TaskMatrix(const JointData* joints, std::size_t count, double sample_time, std::size_t rank)
        : laws_(joints, count, sample_time), alike_(laws_.alike_drives()), size_(count), rank_(rank), stride_((rank + 3) / 4 * 4), factor_(count),
          values_(count), q_(count * stride_), gains_(2 * rank * stride_) {
        for (Dense* one : {&loop_, &loop_omega_}) one->resize(rank, rank);
        for (Dense* one : {&seen_, &seen_omega_}) one->resize(rank, stride_);
        for (Dense* one : {&left_, &right_, &mobility_, &by_row_, &by_mode_}) one->resize(count, stride_);
    }

    const JointLaws& laws() const { return laws_; }
    // Whether all commands reach their motors in the same way.
    bool alike() const { return alike_; }
    // M and dM/dω where `evaluate` was last called.
    const Dense& at() const { return loop_; }
    const Dense& slope() const { return loop_omega_; }

    // δ.
    Complex delta(double omega) const {
        const double step = laws_.sample_time();
        return step > 0.0 ? (1.0 - Complex(std::cos(omega * step), -std::sin(omega * step))) / step : Complex(0.0, omega);
    }

    // M, and with `slopes` dM/dω.
    GAINROOM_WIDE void evaluate(const double* posture, double omega, bool slopes) {
        const std::size_t n = size_;
        laws_.open(omega, values_.data());
        factor_.factor(posture, values_.data());
        in_fours(posture + n * n, n, q_.data());
        in_fours(posture + n * n + n * rank_, 2 * rank_, gains_.data());
        spread(left_, false);
        if (slopes && !alike_) spread(right_, true);
        for (std::size_t i = 0; i < n; i++) {
            const OpenValue& value = values_[i];
            const Complex outward = over(1.0, value.outer), p = times(times(value.outer_omega, outward), outward);
            combine(i, value.through, -outward, mobility_);
            if (!alike_) drive(i, value.drive, value.alias, mobility_);
            if (!slopes) continue;
            combine(i, value.through_omega, p, by_row_);
            if (!alike_) {
                drive(i, value.drive, 0.0, by_row_);
                combine(i, times(value.through, value.drive_omega) + value.alias_omega, -times(outward, value.drive_omega), by_row_, true);
            }
            combine(i, p, value.beta_omega, by_mode_);
        }
        see(slopes);
        if (alike_) drive_all(slopes);
        close(omega, slopes);
    }

private:
    // Rows of `rank` numbers as rows of whole fours.
    GAINROOM_INLINE void in_fours(const double* rows, std::size_t count, double* to) const {
        for (std::size_t i = 0; i < count; i++)
            for (std::size_t k = 0; k < rank_; k++) to[i * stride_ + k] = rows[i * rank_ + k];
    }

    // Solutions of (W + diag β) V = diag(1/outer) Q, or with diag(h) Q in place of Q.
    GAINROOM_INLINE void spread(Dense& found, bool driven) const {
        for (std::size_t i = 0; i < size_; i++) {
            Complex scale = over(1.0, values_[i].outer);
            if (driven) scale = times(scale, values_[i].drive);
            for (std::size_t k = i * stride_; k < (i + 1) * stride_; k++) {
                found.re[k] = scale.real() * q_[k];
                found.im[k] = scale.imag() * q_[k];
            }
        }
        factor_.solve(found.re.data(), found.im.data(), stride_);
    }

    // Row i of `to` becomes, or grows by, that of Q times a and that of V times b.
    GAINROOM_INLINE void combine(std::size_t i, Complex a, Complex b, Dense& to, bool more = false) const {
        for (std::size_t k = i * stride_; k < (i + 1) * stride_; k += 4) {
            const Four q = four(&q_[k]), x = four(&left_.re[k]), y = four(&left_.im[k]);
            Four re = a.real() * q + (b.real() * x - b.imag() * y), im = a.imag() * q + (b.real() * y + b.imag() * x);
            if (more) {
                re += four(&to.re[k]);
                im += four(&to.im[k]);
            }
            put(&to.re[k], re);
            put(&to.im[k], im);
        }
    }

    // Row i of `to` times `factor`, and Q's times `alias`.
    GAINROOM_INLINE void drive(std::size_t i, Complex factor, Complex alias, Dense& to) const {
        to.scale(i, factor, 0);
        for (std::size_t k = i * stride_; k < (i + 1) * stride_; k++) {
            to.re[k] += alias.real() * q_[k];
            to.im[k] += alias.imag() * q_[k];
        }
    }

    // S = Qᵀ diag … Q from its parts, joint by joint; and its slope.
    GAINROOM_INLINE void see(bool slopes) {
        const Dense& right = alike_ ? left_ : right_;
        for (std::size_t k = 0; k < rank_; k++)
            for (std::size_t l = 0; l < stride_; l += 4) {
                const double nothing[4] = {};
                Four re = four(nothing), im = re, re_omega = re, im_omega = re;
                for (std::size_t row = 0; row < size_ * stride_; row += stride_) {
                    const Four q = four(&q_[row + l]);
                    re += mobility_.re[row + k] * q;
                    im += mobility_.im[row + k] * q;
                    if (!slopes) continue;
                    const Four x = four(&right.re[row + l]), y = four(&right.im[row + l]);
                    const double a = by_mode_.re[row + k], b = by_mode_.im[row + k];
                    re_omega += by_row_.re[row + k] * q + (a * x - b * y);
                    im_omega += by_row_.im[row + k] * q + (a * y + b * x);
                }
                put(&seen_.re[k * stride_ + l], re);
                put(&seen_.im[k * stride_ + l], im);
                put(&seen_omega_.re[k * stride_ + l], re_omega);
                put(&seen_omega_.im[k * stride_ + l], im_omega);
            }
    }

    // Drives that are alike scale the mobility of the whole, to which aliases add.
    GAINROOM_INLINE void drive_all(bool slopes) {
        const OpenValue& drive = values_[0];
        for (std::size_t k = 0; k < rank_ * stride_; k++) {
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
            for (std::size_t k = 0; k < rank_; k++) {
                add(seen_, k, q_[i * stride_ + k] * values_[i].alias, &q_[i * stride_]);
                if (slopes) add(seen_omega_, k, q_[i * stride_ + k] * values_[i].alias_omega, &q_[i * stride_]);
            }
    }

    // Row k of `to` grows by `factor` times a real row.
    GAINROOM_INLINE void add(Dense& to, std::size_t k, Complex factor, const double* row) const {
        double *re = &to.re[k * stride_], *im = &to.im[k * stride_];
        for (std::size_t l = 0; l < stride_; l += 4) {
            put(re + l, four(re + l) + factor.real() * four(row + l));
            put(im + l, four(im + l) + factor.imag() * four(row + l));
        }
    }

    // M = S (R_p + δ R_v) and its slope, from S.
    GAINROOM_INLINE void close(double omega, bool slopes) {
        const double step = laws_.sample_time();
        const Complex rate = delta(omega), rate_omega = times(Complex(0.0, 1.0), 1.0 - step * rate);
        for (std::size_t k = 0; k < rank_; k++)
            for (std::size_t l = 0; l < rank_; l += 4) {
                const double nothing[4] = {};
                Four re = four(nothing), im = re, re_omega = re, im_omega = re;
                for (std::size_t m = 0; m < rank_; m++) {
                    const Four p = four(&gains_[m * stride_ + l]), v = four(&gains_[(rank_ + m) * stride_ + l]);
                    const Complex seen = seen_.at(k, m), damped = times(seen, rate);
                    re += seen.real() * p;
                    im += seen.imag() * p;
                    re += damped.real() * v;
                    im += damped.imag() * v;
                    if (!slopes) continue;
                    const Complex turned = seen_omega_.at(k, m), both = times(turned, rate) + times(seen, rate_omega);
                    re_omega += turned.real() * p;
                    im_omega += turned.imag() * p;
                    re_omega += both.real() * v;
                    im_omega += both.imag() * v;
                }
                keep(k, l, re, im, loop_);
                if (slopes) keep(k, l, re_omega, im_omega, loop_omega_);
            }
    }

    GAINROOM_INLINE void keep(std::size_t k, std::size_t l, const Four& re, const Four& im, Dense& to) const {
        double x[4], y[4];
        put(x, re);
        put(y, im);
        for (std::size_t c = 0; c < 4 && l + c < rank_; c++) to.set(k, l + c, {x[c], y[c]});
    }

    JointLaws laws_;
    bool alike_;
    std::size_t size_, rank_, stride_;  // whole fours
    SymmetricFactor factor_;
    Vector<OpenValue> values_;
    Vector<double> q_, gains_;  // Q (n, r); R_p and R_v, rows in whole fours
    Dense left_, right_, mobility_, by_row_, by_mode_, seen_, seen_omega_;  // likewise: V, what S is made of, S
    Dense loop_, loop_omega_;
};

}  // namespace gainroom
