// Gain matrices of rank r, as tasks have them, as the tracker's loop: D = Q (R_p + δ R_v) Qᵀ with Q (n, r), which go with the posture.
//
// With the mobility P_M of n joints without control (joint_law.hpp), whose motors the commands reach through drives h and aliases ε, and
// δ = s, sampled (1 − 1/z)/T_s, the closed loop has its roots where
//
//     det(I + g M) = 0,    M = Qᵀ (P_M diag(h) + diag(ε)) Q (R_p + δ R_v)    (r, r).
//
// P_M does not depend on g, and takes one factorization of W + diag β at a frequency. A crossing has a mode y and a left mode z,
// zᵀ (I + g M) = 0; −1/g and ω balance zᵀMy/zᵀy, wrong by the product of both modes' errors. A posture is W, Q, R_p, R_v and, to
// tell how far it is from another one, J^(−½) Q R_v Qᵀ J^(−½), one after the other; what no task holds drifts at s = 0 at any g, and is no part of M.
//
// F = det(I + g M) is 1 without control. On the way from g = 0, at one frequency, its phase is Σ arg(1 + g μ), μ the eigenvalues of M, as long
// as none of them is on the negative half axis. Crossings are followed above about the frequency up to which the tasks' controllers take
// energy out. Below it the plant has its sharpest resonances, and joint gains that are not symmetric prove nothing about energy: there a count
// of its own goes down to where the loop is that of a rigid robot, M about −N/ω², and all its eigenvalues have to lie below the axis all the
// way: so it is stable at lower factors as well, down to those that are too weak to move the robot within `slowest`.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

#include "block.hpp"
#include "dense.hpp"
#include "eigenvalues.hpp"
#include "posture_change.hpp"
#include "task_matrix.hpp"
#include "tracked_loop.hpp"

namespace gainroom {

class TaskLoop final : public TrackedLoop {
public:
    // Of `rank` r; kp and kd of `joints` do not count. sample_time 0: continuous. Up to `leading` [rad/s] tasks take energy out.
    TaskLoop(const JointData* joints, std::size_t count, double sample_time, std::size_t rank, double leading)
        : matrix_(joints, count, sample_time, rank), size_(count), rank_(rank),
          corner_(corner(joints, count)), lowest_(kBelow * leading), slowest_(std::min(kSlow * std::min(corner_, leading), lowest_)),
          change_(count), values_(count), y_(rank), z_(rank), eigenvalues_(rank) {
        inverse_.resize(rank, rank);
        exchanged_.resize(rank);
        copy_.resize(rank * rank);
        solver_.reserve(rank);
    }

    const JointLaws& laws() const { return matrix_.laws(); }
    std::size_t rank() const { return rank_; }
    // Where `phase` was last: M and dM/dω.
    const Dense& matrix() const { return matrix_.at(); }
    const Dense& slope() const { return matrix_.slope(); }
    // Of M there (r); false where there are none. They stay where they are until the next call.
    bool find_eigenvalues() { return solver_.find(matrix().re.data(), matrix().im.data(), rank_, eigenvalues_.data()); }
    const Vector<Complex>& eigenvalues() const { return eigenvalues_; }

    std::size_t posture_size() const override { return size(size_, rank_); }
    static std::size_t size(std::size_t joints, std::size_t rank) { return 2 * joints * joints + joints * rank + 2 * rank * rank; }
    std::size_t mode_size() const override { return 2 * rank_; }
    std::size_t channels() const override { return rank_; }
    double sample_time() const override { return laws().sample_time(); }
    double lowest() const override { return lowest_; }
    double slowest() const override { return slowest_; }
    double usual_slices() const override { return std::max(kSlices / cost(), 1.0); }
    double urgent_slices() const override { return std::max(8.0 * kSlices / cost(), 6.0); }
    double prepared_slices() const override { return 0.3 * urgent_slices(); }

    double farthest() const override { return 0.6; }
    double followed() const override { return 2.0; }
    // As far as `distance` is, |g μ| changes by that about, and those of the count by more than the lowest crossing's: 1 to 1.6 in its logarithm.
    double slowest_speed() const override { return 1.25; }

    // Of W, as PostureChange has it, and of the damping, relative to the larger of both: as far as that is there is a way of finitely many strides.
    double distance(const double* before, const double* now) override {
        const double *old = before + posture_size() - size_ * size_, *fresh = now + posture_size() - size_ * size_;
        double change = 0.0, size = 0.0, size_before = 0.0;
        for (std::size_t k = 0; k < size_ * size_; k++) {
            change += (fresh[k] - old[k]) * (fresh[k] - old[k]);
            size += fresh[k] * fresh[k];
            size_before += old[k] * old[k];
        }
        return change_(laws(), before, now) + std::sqrt(change / std::max(std::max(size, size_before), 1e-300));
    }

    bool follow(const double* posture, TrackedCrossing& crossing, int steps, double& work, bool rough) override {
        crossing.converged = false;
        crossing.spread = kUnknown;
        for (int k = 0; k < steps; k++) {
            matrix_.evaluate(posture, crossing.omega, true);
            work += 1.0;
            if (!sharpen(crossing, k == 0 ? 2 : 1)) return false;
            Complex size = 0.0, whole = 0.0, slope = 0.0;  // zᵀy, zᵀMy, zᵀM'y
            for (std::size_t i = 0; i < rank_; i++) {
                Complex row = 0.0, row_omega = 0.0;
                for (std::size_t j = 0; j < rank_; j++) {
                    row += times(matrix().at(i, j), y_[j]);
                    row_omega += times(matrix_.slope().at(i, j), y_[j]);
                }
                size += times(z_[i], y_[i]);
                whole += times(z_[i], row);
                slope += times(z_[i], row_omega);
            }
            whole = over(whole, size);
            slope = over(slope, size);
            // zᵀMy/zᵀy + Δ zᵀM'y/zᵀy = −1/g, both sides real
            double step = -whole.imag() / slope.imag(), inverse = -whole.real() - step * slope.real();
            if (!std::isfinite(inverse)) return false;
            if (const double most = 0.1 * crossing.omega; std::fabs(step) > most) {
                step = std::copysign(most, step);
                inverse = -whole.real() - step * slope.real();
            }
            inverse = std::min(std::max(inverse, 0.8 / crossing.gain), 1.25 / crossing.gain);
            const double off = std::fabs(step) / crossing.omega, turned = std::fabs(inverse * crossing.gain - 1.0);
            crossing.omega += step;
            crossing.gain = 1.0 / inverse;
            crossing.rising = slope.imag();  // of the sign of Im F_g/F_ω
            keep_modes(crossing);
            if (rough && off + turned < kRough) return true;
            if (off < kNear * resolution(crossing.omega) && turned < kTurned && residual(step, crossing.gain) < kResidual)
                return crossing.converged = true;
        }
        return false;
    }

    double phase(const double* posture, double omega, double gain, Complex* slope) override {
        matrix_.evaluate(posture, omega, slope != nullptr);
        gain_ = gain;
        omega_ = omega;
        LogDeterminant determinant;
        if (!closed(gain, determinant)) return std::numeric_limits<double>::quiet_NaN();
        if (slope) {
            *slope = 0.0;
            for (std::size_t i = 0; i < rank_; i++)
                for (std::size_t j = 0; j < rank_; j++) *slope += gain * times(inverse_.at(i, j), matrix_.slope().at(j, i));
        }
        return determinant.value().imag();
    }

    double whole_phase() override { return whole_phase_at(gain_); }

    double lower_cost() const override { return kTime * double(rank_ * rank_ * rank_) / cost(); }
    double phase_at(double gain) override {
        close(gain);
        if (!factorise(inverse_, exchanged_)) return std::numeric_limits<double>::quiet_NaN();
        LogDeterminant determinant;
        for (std::size_t k = 0; k < rank_; k++) determinant.multiply(exchanged_[k] == k ? inverse_.at(k, k) : -inverse_.at(k, k));
        return determinant.value().imag();
    }
    double whole_phase_at(double gain) override {
        if (gain == 0.0) return 0.0;
        const bool known = find_eigenvalues() && (omega_ > slowest_ || leading());
        double sum = known ? 0.0 : std::numeric_limits<double>::quiet_NaN();
        for (const Complex mu : eigenvalues_) sum += std::atan2(gain * mu.imag(), 1.0 + gain * mu.real());
        return sum;
    }

    // Where eigenvalues of two directions meet, as near singular postures, they part as a pair, one of them upwards, within hardly any motion. Damping
    // keeps them below the axis, the less so the lower the frequency: so it is seen here first.
    bool leads_slowly(const double* posture, double gain) override {
        matrix_.evaluate(posture, slowest_, false);
        gain_ = gain;
        return find_eigenvalues() && leading();
    }

    // Eigenvalues above the negative half of the axis may have come across it, or are about to; those above the positive half came across that, or
    // the count is not 0.
    double clear_gain() override {
        if (!find_eigenvalues()) return 0.0;
        double most = 0.0;
        for (const Complex mu : eigenvalues_)
            if (!(mu.imag() < 0.0) && !(mu.real() > 0.0)) most = std::max(most, std::norm(mu));
        return kNever / std::sqrt(most);
    }

    // Motors' velocities and torques exchange energy through a passive robot. What commands make of velocities, Z = s h (R_p + δ R_v), takes
    // energy out where Z + Zᴴ > 0, and the loop has no root at jω for any g. Aliases stand beside the robot, as a mobility ε/(s h), which
    // may bring in some: Z + Zᴴ + 2g min(Re ε/(s h)) ZᴴZ > 0 holds for all lower g as well.
    double clear_until(const double* posture, double omega, double gain) override {
        double end = omega;
        if (!matrix_.alike()) return end;
        for (double next = omega; leads(posture, std::min(next, lowest_), gain); next *= kPace) {
            end = std::min(next, lowest_);
            if (end == lowest_) break;
        }
        return end;
    }

    // |D − Dᵀ|/|D| of the damping D: symmetric gains take energy out.
    double one_sided(const double* posture) override {
        const double* damping = posture + posture_size() - size_ * size_;
        double apart = 0.0, whole = 0.0;
        for (std::size_t i = 0; i < size_; i++)
            for (std::size_t j = 0; j < size_; j++) {
                const double one = damping[i * size_ + j], off = one - damping[j * size_ + i];
                apart += off * off;
                whole += one * one;
            }
        return whole > 0.0 ? std::sqrt(apart / whole) : 0.0;
    }

    bool has_poles() const override { return true; }
    double resonance(const double* posture) const override { return laws().highest_resonance(posture); }

    double top(const double* posture, double gain, double from) override {
        const double *p = posture + size_ * size_ + size_ * rank_, *v = p + rank_ * rank_;
        double stiff = 0.0, damped = 0.0, omega = from;
        for (std::size_t k = 0; k < rank_ * rank_; k++) {
            stiff += p[k] * p[k];
            damped += v[k] * v[k];
        }
        for (int k = 0; k < 100; k++, omega *= 1.3)
            if (gain * laws().strongest(omega) * std::sqrt(stiff + omega * omega * damped) < 0.1) break;
        return omega;
    }

    double resolution(double omega) const override {
        if (!(omega < kSmooth * corner_)) return laws().resolution(omega, kWidest);
        return std::min(kLong, std::max(kSmooth * corner_ / omega - 1.0, 1e-3));
    }

private:
    static constexpr double kSlices = 12.0;                      // µs of an ordinary tick for slices; see `cost`
    static constexpr double kPace = 1.1;   // of ω, from one look to the next
    static constexpr double kBelow = 0.9;  // of `leading`
    static constexpr double kSlow = 0.003, kSmooth = 0.9, kLong = 0.4;  // of the first corner of the plant; steps up to there
    static constexpr double kTime = 1.2e-3;                      // µs of a product and a sum of complex numbers
    static constexpr double kDefinite = 1e-6;                    // of a pivot
    static constexpr double kWeak = 1e-6, kNever = 0.9;          // |g μ| that does not turn the phase, or never becomes 1 at lower g
    static constexpr double kRough = 1e-3, kResidual = 1e-6, kTurned = 1e-3, kNear = 1e-4;  // of steps; kNear: of a resonance's width
    static constexpr double kBeside = 1e-7, kUnknown = 1e300;    // of g, beside the root, where nothing is singular

    // Whether all eigenvalues that turn the phase lie below the axis, as where tasks take energy out.
    bool leading() const {
        for (const Complex mu : eigenvalues_)
            if (gain_ * gain_ * std::norm(mu) > kWeak * kWeak && !(mu.imag() < 0.0)) return false;
        return true;
    }

    // Of one slice, about [µs].
    double cost() const {
        const double n = double(size_), r = double(rank_);
        return kTime * (n * n * n / 6 + n * n * r + 1.5 * n * r * r + 3 * r * r * r) + 0.5;
    }

    // Below every resonance.
    static double corner(const JointData* joints, std::size_t count) {
        double lowest = 1e9;
        for (std::size_t i = 0; i < count; i++)
            if (std::isfinite(joints[i].stiffness)) lowest = std::min(lowest, std::sqrt(joints[i].stiffness / joints[i].motor_inertia));
        return lowest;
    }

    // Whether Z, with what aliases bring in, takes energy out at jω: L D Lᴴ with positive pivots.
    bool leads(const double* posture, double omega, double gain) {
        const std::size_t r = rank_;
        const double* gains = posture + size_ * size_ + size_ * r;
        laws().open(omega, values_.data());
        const Complex drive = times(Complex(0.0, omega), values_[0].drive), rate = matrix_.delta(omega);
        double worst = 0.0;
        for (std::size_t i = 0; i < size_; i++) worst = std::min(worst, over(values_[i].alias, drive).real());
        for (std::size_t k = 0; k < r * r; k++) {
            const Complex one = times(drive, gains[k] + gains[r * r + k] * rate);
            inverse_.re[k] = one.real();
            inverse_.im[k] = one.imag();
        }
        for (std::size_t k = 0; k < r; k++)
            for (std::size_t l = 0; l <= k; l++) {
                Complex sum = inverse_.at(k, l) + std::conj(inverse_.at(l, k));
                if (worst < 0.0)
                    for (std::size_t m = 0; m < r; m++) sum += 2.0 * gain * worst * times(std::conj(inverse_.at(m, k)), inverse_.at(m, l));
                copy_[k * r + l] = sum;
            }
        double largest = 0.0;
        for (std::size_t k = 0; k < r; k++) largest = std::max(largest, copy_[k * r + k].real());
        for (std::size_t k = 0; k < r; k++) {
            const double before = copy_[k * r + k].real();
            if (idle(gains, k)) continue;
            double pivot = before;
            for (std::size_t m = 0; m < k; m++) pivot -= std::norm(copy_[k * r + m]);
            if (!(pivot > kDefinite * before)) return false;
            pivot = std::sqrt(pivot);
            copy_[k * r + k] = pivot;
            for (std::size_t i = k + 1; i < r; i++) {
                Complex sum = copy_[i * r + k];
                for (std::size_t m = 0; m < k; m++) sum -= times(copy_[i * r + m], std::conj(copy_[k * r + m]));
                copy_[i * r + k] = sum / pivot;
            }
        }
        return largest > 0.0;
    }

    // Whether a direction has no gain at all.
    bool idle(const double* gains, std::size_t k) const {
        double sum = 0.0;
        for (std::size_t l = 0; l < rank_; l++)
            for (const std::size_t at : {k * rank_ + l, l * rank_ + k}) sum += std::fabs(gains[at]) + std::fabs(gains[rank_ * rank_ + at]);
        return sum == 0.0;
    }

    // I + g M.
    void close(double gain) {
        for (std::size_t k = 0; k < rank_ * rank_; k++) {
            inverse_.re[k] = gain * matrix().re[k] + (k % (rank_ + 1) == 0 ? 1.0 : 0.0);
            inverse_.im[k] = gain * matrix().im[k];
        }
    }
    // Its inverse.
    bool closed(double gain, LogDeterminant& determinant) {
        close(gain);
        return invert(inverse_, exchanged_, determinant);
    }

    // y and z from the crossing's mode, whose second half is z's conjugate, by inverse iteration; scaled so that zᵀy > 0.
    bool sharpen(TrackedCrossing& crossing, int passes) {
        LogDeterminant unused;
        if (!closed((1.0 + kBeside) * crossing.gain, unused)) return false;
        const Complex* mode = crossing.mode.data();
        for (int pass = 0; pass < passes; pass++) {
            for (std::size_t i = 0; i < rank_; i++) {
                y_[i] = z_[i] = 0.0;
                for (std::size_t j = 0; j < rank_; j++) {
                    y_[i] += times(inverse_.at(i, j), mode[j]);
                    z_[i] += times(inverse_.at(j, i), std::conj(mode[rank_ + j]));
                }
            }
            Complex same = 0.0, both = 0.0;
            for (std::size_t i = 0; i < rank_; i++) same += times(std::conj(y_[i]), mode[i]);
            if (!scaled(y_, std::norm(same) > 0.0 ? same / std::sqrt(std::norm(same)) : Complex(1.0))) return false;
            for (std::size_t i = 0; i < rank_; i++) both += times(z_[i], y_[i]);
            if (!scaled(z_, std::conj(both) / std::sqrt(std::norm(both)))) return false;
            keep_modes(crossing);
        }
        return true;
    }

    // To the size √½, and turned by `turn` of size one.
    static bool scaled(Vector<Complex>& vector, Complex turn) {
        double size = 0.0;
        for (const Complex one : vector) size += std::norm(one);
        if (!(size > 0.0) || !std::isfinite(size)) return false;
        turn *= std::sqrt(0.5 / size);
        for (Complex& one : vector) one = times(one, turn);
        return true;
    }

    void keep_modes(TrackedCrossing& crossing) const {
        for (std::size_t i = 0; i < rank_; i++) {
            crossing.mode[i] = y_[i];
            crossing.mode[rank_ + i] = std::conj(z_[i]);
        }
    }

    // |(I + g (M + Δ M')) y|, relative.
    double residual(double step, double gain) const {
        double left = 0.0, size = 0.0;
        for (std::size_t i = 0; i < rank_; i++) {
            Complex row = y_[i];
            for (std::size_t j = 0; j < rank_; j++) row += gain * times(matrix().at(i, j) + step * matrix_.slope().at(i, j), y_[j]);
            left += std::norm(row);
            size += std::norm(y_[i]);
        }
        return std::sqrt(left / size);
    }

    TaskMatrix matrix_;
    std::size_t size_, rank_;
    double corner_, lowest_, slowest_, gain_ = 0.0, omega_ = 0.0;
    PostureChange change_;
    Vector<OpenValue> values_;
    Dense inverse_;
    Vector<Complex> y_, z_, eigenvalues_, copy_;
    Vector<std::size_t> exchanged_;
    Eigenvalues solver_;
};

}  // namespace gainroom
