// Joint-space PD, one kp and kd per joint, as the tracker's loop: a posture is W (n, n), a mode x solves (W + diag β) x = 0.
//
// F = Π α_i · det(W + diag β) has the closed loop's roots (joint_law.hpp). Where every joint's controller only takes energy out, and without
// control, its phase is known not only up to turns: there Im β > 0, and every pivot of L D Lᵀ lies in the upper half plane.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "block.hpp"
#include "crossing_follower.hpp"
#include "four_factors.hpp"
#include "neighbours.hpp"
#include "posture_change.hpp"

namespace gainroom {

class JointLoop final : public TrackedLoop {
public:
    // sample_time 0: continuous.
    JointLoop(const JointData* joints, std::size_t count, double sample_time)
        : laws_(joints, count, sample_time), lowest_(laws_.passive_end()), follower_(laws_), neighbours_(laws_), change_(count), values_(count), factor_(count),
          work_(SymmetricFactor::room(count)), four_(count), beta_(kEntry * count), beta_omega_(beta_), outer_(beta_), outer_omega_(beta_), whole_(beta_) {}
    JointLoop(const JointLoop&) = delete;  // parts refer to each other

    const JointLaws& laws() const { return laws_; }
    CrossingFollower& follower() { return follower_; }

    std::size_t posture_size() const override { return laws_.size() * laws_.size(); }
    std::size_t mode_size() const override { return laws_.size(); }
    std::size_t channels() const override { return laws_.size(); }
    double sample_time() const override { return laws_.sample_time(); }
    double lowest() const override { return lowest_; }
    double usual_slices() const override { return std::max(kSlices / double(posture_size()), 1.5); }
    double urgent_slices() const override { return std::max(7.0 * kSlices / double(posture_size()), std::min(kEach * double(mode_size()), kUrgent)); }

    double prepared_slices() const override { return std::max(3.0 * usual_slices(), kPrepared); }

    double distance(const double* before, const double* now) override { return change_(laws_, before, now); }

    bool follow(const double* w, TrackedCrossing& crossing, int steps, double& work, bool rough) override {
        return follower_.follow(w, crossing, steps, work, rough);
    }

    double least_gain(const double* w, const TrackedCrossing& crossing, double ahead, double& work) override {
        return follower_.least_gain(w, crossing, ahead, work);
    }

    double beside() const override { return Neighbours::kBeside; }
    bool clear_below(const double* w, TrackedCrossing& crossing, const TrackedCrossing& lowest, double& work) override {
        return neighbours_.clear(w, crossing, lowest, follower_.beside(w, crossing, work), work);
    }
    bool start_below(int which, TrackedCrossing& trial) override { return neighbours_.start(which, trial); }

    double phase(const double* w, double omega, double gain, Complex* slope) override {
        laws_.at(omega, gain, values_.data());
        factor_.factor(w, values_.data());
        Complex product = 1.0;
        for (std::size_t i = 0; i < laws_.size(); i++) {
            const Complex one = times(factor_.pivot(i), times(values_[i].outer, values_[i].factor));
            product = times(product, one * (1.0 / (std::fabs(one.real()) + std::fabs(one.imag()))));
        }
        if (slope) {
            *slope = factor_.trace(values_.data(), work_.data());
            for (std::size_t i = 0; i < laws_.size(); i++) *slope += over(values_[i].outer_omega, values_[i].outer);
        }
        return std::arg(product);
    }

    double phases(const double* w, double gain, Slice* slices, std::size_t count) override {
        for (std::size_t lane = 0; lane < kLanes; lane++) {  // the last one fills up
            laws_.at(slices[std::min(lane, count - 1)].omega, gain, values_.data());
            for (std::size_t i = 0; i < laws_.size(); i++) {
                const JointValue& value = values_[i];
                put(&beta_[kEntry * i], lane, value.beta);
                put(&beta_omega_[kEntry * i], lane, value.beta_omega);
                put(&outer_[kEntry * i], lane, value.outer);
                put(&outer_omega_[kEntry * i], lane, value.outer_omega);
                put(&whole_[kEntry * i], lane, times(value.outer, value.factor));
            }
        }
        four_.factor(w, beta_.data());
        combine();
        for (std::size_t k = 0; k < count; k++) {
            slices[k].phase = std::atan2(product_[kLanes + k], product_[k]);
            slices[k].slope = {slope_[k], slope_[kLanes + k]};
        }
        return kFour;
    }
    std::size_t at_once() const override {
        static_assert(kLanes <= kMostAtOnce);
        return kLanes;
    }

    // α = a (1/a + e)/β, each factor in a half plane that is known.
    double whole_phase() override {
        double sum = 0.0;
        for (std::size_t i = 0; i < laws_.size(); i++) {
            const JointValue& value = values_[i];
            const Complex beside = times(value.outer, over(value.beta, value.inner));  // 1/a + e
            sum += upper(factor_.pivot(i)) - upper(std::conj(value.inner)) + upper(beside) - upper(value.beta) + std::arg(value.factor);
        }
        return sum;
    }

    double resonance(const double* w) const override { return laws_.highest_resonance(w); }

    double top(const double*, double gain, double from) override {
        double omega = from;
        for (int k = 0; k < 100 && !(laws_.strongest_control(omega, gain) < 0.1); k++) omega *= 1.3;
        return omega;
    }

    double resolution(double omega) const override { return laws_.resolution(omega, kWidest); }

private:
    static constexpr double kSlices = 432.0;  // over n²: with 12 joints 3 slices, which is 4 µs
    static constexpr double kPrepared = 10.0;  // slices at least: following what has been left behind takes most of them
    static constexpr double kFour = 1.75;     // slices that four at once cost
    static constexpr double kEach = 0.54, kUrgent = 20.0;  // slices per joint, of about two that a count takes, without a certificate; at most

    // Of the four: F, but for its size, and the slope of its logarithm.
    GAINROOM_WIDE void combine() {
        FourComplex slope = four_.trace(beta_omega_.data());
        for (std::size_t lane = 0; lane < kEntry; lane++) product_[lane] = lane < kLanes ? 1.0 : 0.0;
        for (std::size_t i = 0; i < laws_.size(); i++) {
            slope = slope + entry(&outer_omega_[kEntry * i]) * inverse_of(entry(&outer_[kEntry * i]));
            put(product_, entry(product_) * (four_.pivot(i) * entry(&whole_[kEntry * i])));
            for (std::size_t lane = 0; lane < kLanes; lane++) {
                const double scale = 1.0 / (std::fabs(product_[lane]) + std::fabs(product_[kLanes + lane]));
                product_[lane] *= scale;
                product_[kLanes + lane] *= scale;
            }
        }
        put(slope_, slope);
    }

    // arg in [0, π] of what is in the upper half plane but for round-off; elsewhere arg in (−π, 0).
    static double upper(Complex z) {
        if (z.imag() < 0.0 && -z.imag() < 1e-9 * std::fabs(z.real())) return z.real() > 0.0 ? 0.0 : kPi;
        return std::arg(z);
    }

    JointLaws laws_;
    double lowest_;
    CrossingFollower follower_;
    Neighbours neighbours_;
    PostureChange change_;
    Vector<JointValue> values_;
    SymmetricFactor factor_;
    Vector<double> work_;
    FourFactors four_;  // and what it and F are made of, of four frequencies
    Vector<double> beta_, beta_omega_, outer_, outer_omega_, whole_;
    double product_[kEntry], slope_[kEntry];
};

}  // namespace gainroom
